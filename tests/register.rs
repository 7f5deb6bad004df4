//! Inner loops of registration, against what is known.

use beltrami::near::{KdTree, nearest_rows};
use beltrami::register::{Rigid, Spectral, Triple, ascend, functional_map, point_maps, polar, upsample};
use beltrami::{Control, Csr, Error};
use proptest::prelude::*;

/// Numbers from -1 to 1 that look random.
fn noise(count: usize, seed: u64) -> Vec<f64> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(1);
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    };
    (0..count).map(|_| next()).collect()
}

fn orthogonal(n: usize, seed: u64) -> Vec<f64> {
    polar(&noise(n * n, seed), n).unwrap()
}

proptest! {
    #[test]
    fn nearest_rows_are_those_of_the_tree(
        dimension in 1usize..40,
        numbers in prop::collection::vec(prop_oneof![(-2i32..3).prop_map(f64::from), -3.0..3.0f64], 40..1200),
        scale in prop_oneof![Just(1.0), Just(1e-150), Just(1e90)],
    ) {
        let points: Vec<f64> = numbers[..numbers.len() / dimension * dimension].iter().map(|x| x * scale).collect();
        let mut queries = noise(7 * dimension, 3).iter().map(|x| x * scale).collect::<Vec<_>>();
        queries.extend_from_slice(&points);
        let control = Control::default();
        let (indices, distances) = nearest_rows(&points, dimension, &queries, &control).unwrap();
        let tree = KdTree::new(&points, dimension, &control).unwrap().nearest(&queries, 1, &control).unwrap();
        prop_assert_eq!(indices, tree.0);
        prop_assert_eq!(distances, tree.1);
    }

    #[test]
    fn polar_factors_are_orthogonal(n in 1usize..20, seed in 0u64..1000) {
        let turn = orthogonal(n, seed);
        for i in 0..n {
            for j in 0..n {
                let dot: f64 = (0..n).map(|k| turn[i * n + k] * turn[j * n + k]).sum();
                prop_assert!((dot - f64::from(u8::from(i == j))).abs() < 1e-13);
            }
        }
    }
}

/// Blocks of points that are too far are left out, from some thousand points on: the answers stay those of comparing with all.
#[test]
fn nearest_rows_of_a_surface_are_those_of_the_tree() {
    let (dimension, count) = (12, 9000);
    let places = noise(2 * count, 5);
    let mut points = Vec::new();
    for place in places.chunks_exact(2) {
        for wave in 1..=dimension / 4 {
            let (one, other) = (wave as f64 * 3.0 * place[0], wave as f64 * 3.0 * place[1]);
            points.extend([one.sin(), one.cos(), other.sin(), other.cos()]);
        }
    }
    points.copy_within(0..40 * dimension, 5000 * dimension); // of points that are there twice, the first
    let strangers = noise(300 * dimension, 6);
    let beside: Vec<f64> = points.iter().zip(noise(points.len(), 7)).map(|(x, e)| x + 0.05 * e).collect();
    let control = Control::default();
    let tree = KdTree::new(&points, dimension, &control).unwrap();
    for queries in [&points, &beside, &strangers, &points[..0].to_vec()] {
        assert_eq!(nearest_rows(&points, dimension, queries, &control).unwrap(), tree.nearest(queries, 1, &control).unwrap());
    }
    for (offset, scale) in [(1e6, 1e-3), (1e6, 1e-8), (0.0, 1e-310), (0.0, 1e-24)] {
        let [far, near] = [&points, &beside].map(|table| table.iter().map(|x| offset + x * scale).collect::<Vec<f64>>());
        let tree = KdTree::new(&far, dimension, &control).unwrap();
        assert_eq!(nearest_rows(&far, dimension, &near, &control).unwrap(), tree.nearest(&near, 1, &control).unwrap(), "{offset} {scale}");
    }
    assert_eq!(nearest_rows(&[0.5; 14_000], 2, &[0.0, 1.0], &control).unwrap().0, [0]);
}

/// The same triple products seen from turned axes: B with `<A, C B>` greatest at C.
fn turned(a: &[f64], c: &[f64], n: usize) -> Vec<f64> {
    let mut b = vec![0.0; n * n * n];
    for (l, m, p) in (0..n).flat_map(|l| (0..n).flat_map(move |m| (0..n).map(move |p| (l, m, p)))) {
        for (i, j, k) in (0..n).flat_map(|i| (0..n).flat_map(move |j| (0..n).map(move |k| (i, j, k)))) {
            b[(l * n + m) * n + p] += a[(i * n + j) * n + k] * c[i * n + l] * c[j * n + m] * c[k * n + p];
        }
    }
    b
}

#[test]
fn ascent_stays_at_the_map_that_made_the_products() {
    let n = 5;
    let raw = noise(n * n * n, 1);
    let at = |i: usize, j: usize, k: usize| raw[(i * n + j) * n + k];
    let (mut even, mut odd) = (vec![0.0; n * n * n], vec![0.0; n * n * n]);
    for (i, j, k) in (0..n).flat_map(|i| (0..n).flat_map(move |j| (0..n).map(move |k| (i, j, k)))) {
        let (cycle, back) = (at(i, j, k) + at(j, k, i) + at(k, i, j), at(i, k, j) + at(k, j, i) + at(j, i, k));
        even[(i * n + j) * n + k] = cycle + back;
        odd[(i * n + j) * n + k] = cycle - back;
    }
    for tensor in [&mut even, &mut odd] {
        let norm = tensor.iter().map(|x| x * x).sum::<f64>().sqrt();
        tensor.iter_mut().for_each(|x| *x /= norm);
    }
    let map = orthogonal(n, 2);
    let (other_even, other_odd) = (turned(&even, &map, n), turned(&odd, &map, n));
    let (source, target) = (Triple { even: &even, odd: &odd }, Triple { even: &other_even, odd: &other_odd });
    let (found, scores) = ascend(&map, n, source, target, 1.0, &vec![0.0; n * n], 20, &Control::default()).unwrap();
    assert!((scores[0][0] - 1.0).abs() < 1e-12);
    assert!((scores[0][1] - 1.0).abs() < 1e-12);
    assert!(found.iter().zip(&map).all(|(a, b)| (a - b).abs() < 1e-12));
    let mirrored: Vec<f64> = other_odd.iter().map(|x| -x).collect();
    let target = Triple { even: &other_even, odd: &mirrored };
    let (_, scores) = ascend(&map, n, source, target, 1.0, &vec![0.0; n * n], 0, &Control::default()).unwrap();
    assert!((scores[0][1] + 1.0).abs() < 1e-12);
}

#[test]
fn a_turned_and_renumbered_copy_is_matched_exactly() {
    let (count, modes) = (60, 6);
    let functions = noise(count * modes, 4);
    let map = orthogonal(modes, 5);
    let place = |x: usize| (x * 17 + 3) % count; // 17 and 60 have no common factor
    let mut other = vec![0.0; count * modes];
    for x in 0..count {
        for l in 0..modes {
            other[place(x) * modes + l] = (0..modes).map(|i| functions[x * modes + i] * map[i * modes + l]).sum();
        }
    }
    let masses = vec![1.0 / count as f64; count];
    let source = Spectral { functions: &functions, modes, features: &[], masses: &masses };
    let target = Spectral { functions: &other, modes, features: &[], masses: &masses };
    let control = Control::default();
    let (forward, backward) = point_maps(&map, modes, source, target, &control).unwrap();
    assert!((0..count).all(|x| forward[x] as usize == place(x) && backward[place(x)] as usize == x));
    let both = [map.clone(), map.clone()].concat();
    let again = upsample(&both, modes, modes, source, target, &control).unwrap();
    assert_eq!(again[..modes * modes], again[modes * modes..]);
    assert_eq!(again[..modes * modes], functional_map(&forward, &backward, modes, source, target).unwrap());
}

#[test]
fn a_turned_body_has_no_energy_and_its_right_hand_side_is_its_own() {
    let edges = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)];
    let mut dense = [[0.0; 4]; 4];
    for (k, (i, j)) in edges.into_iter().enumerate() {
        dense[i][j] = 1.0 + k as f64;
        dense[j][i] = dense[i][j];
    }
    let (mut starts, mut indices, mut values) = (vec![0], vec![], vec![]);
    for i in 0..4 {
        for j in (0..4).filter(|&j| j != i) {
            indices.push(j as u32);
            values.push(dense[i][j]);
        }
        starts.push(indices.len());
    }
    let rest = noise(12, 7);
    let rigid = Rigid::new(Csr::new(4, 4, starts, indices, values).unwrap(), &rest).unwrap();
    // a quarter turn about z
    let moved: Vec<f64> = rest.chunks(3).flat_map(|p| [-p[1] + 2.0, p[0], p[2] - 1.0]).collect();
    let fit = rigid.fit(&moved, 0.0).unwrap();
    assert!(fit.energy < 1e-25);
    for i in 0..4 {
        for axis in 0..3 {
            let own: f64 = (0..4).map(|j| dense[i][j] * (moved[3 * i + axis] - moved[3 * j + axis])).sum();
            assert!((fit.right[3 * i + axis] - own).abs() < 1e-12);
        }
    }
    let mirrored: Vec<f64> = rest.chunks(3).flat_map(|p| [-p[0], p[1], p[2]]).collect();
    assert!(rigid.fit(&mirrored, 0.0).unwrap().energy > 0.1, "a mirror is no rotation");
}

#[test]
fn what_does_not_fit_is_refused() {
    let control = Control::default();
    assert!(matches!(nearest_rows(&[1.0, 2.0], 0, &[], &control), Err(Error::Input(_))));
    assert!(matches!(nearest_rows(&[], 2, &[0.0, 0.0], &control), Err(Error::Input(_))));
    assert!(matches!(nearest_rows(&[f64::NAN], 1, &[0.0], &control), Err(Error::Input(_))));
    assert!(matches!(polar(&[1.0, 2.0], 2), Err(Error::Input(_))));
    assert!(matches!(polar(&[f64::INFINITY], 1), Err(Error::Input(_))));
    let side = Spectral { functions: &[1.0, 0.0], modes: 1, features: &[], masses: &[0.5, 0.5] };
    assert!(matches!(point_maps(&[1.0; 4], 2, side, side, &control), Err(Error::Input(_))));
    assert!(matches!(functional_map(&[0, 2], &[0, 1], 1, side, side), Err(Error::Input(_))));
    let lone = Csr::new(1, 1, vec![0, 0], vec![], vec![]).unwrap();
    assert!(matches!(Rigid::new(lone, &[0.0]), Err(Error::Input(_))));
    control.stop();
    assert_eq!(nearest_rows(&[0.0], 1, &[1.0], &control), Err(Error::Cancelled));
}
