//! Neighbours, closest points and rays against brute force.

use beltrami::near::{Bvh, KdTree, Scratch};
use beltrami::{Control, Error, TriangleMesh};
use proptest::prelude::*;

fn squared(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).fold(0.0, |sum, (x, y)| sum + (y - x) * (y - x))
}

fn brute(points: &[f64], dimension: usize, query: &[f64]) -> Vec<(f64, u32)> {
    let mut all: Vec<_> = points.chunks(dimension).enumerate().map(|(i, p)| (squared(p, query), i as u32)).collect();
    all.sort_by(|a, b| a.partial_cmp(b).unwrap());
    all
}

proptest! {
    #[test]
    fn neighbors_are_those_of_brute_force(
        dimension in 1usize..13,
        numbers in prop::collection::vec(prop_oneof![(-3i32..4).prop_map(f64::from), -3.0..3.0f64], 12..600),
        share in 0.0..1.0f64,
        radius in 0.0..4.0f64,
    ) {
        let points = &numbers[..numbers.len() / dimension * dimension];
        let count = points.len() / dimension;
        let wanted = 1 + (share * (count - 1) as f64) as usize;
        let tree = KdTree::new(points, dimension, &Control::default()).unwrap();
        let (indices, distances) = tree.nearest(points, wanted, &Control::default()).unwrap();
        let near = tree.within(points, radius, usize::MAX, &Control::default()).unwrap();
        let mut scratch = Scratch::default();
        for (query, point) in points.chunks(dimension).enumerate() {
            let all = brute(points, dimension, point);
            let (nearest, far): (Vec<u32>, Vec<f64>) = all[..wanted].iter().map(|&(square, i)| (i, square.sqrt())).unzip();
            prop_assert_eq!(&indices[query * wanted..][..wanted], &nearest[..]);
            prop_assert_eq!(&distances[query * wanted..][..wanted], &far[..]);
            tree.nearest_into(point, wanted, &mut scratch).unwrap();
            prop_assert_eq!(scratch.indices(), &nearest[..]);
            let within: Vec<u32> = all.iter().filter(|(square, _)| square.sqrt() <= radius).map(|&(_, i)| i).collect();
            prop_assert_eq!(&near.indices[near.starts[query]..near.starts[query + 1]], &within[..]);
            tree.within_into(point, radius, &mut scratch).unwrap();
            prop_assert_eq!(scratch.indices(), &within[..]);
        }
        let mut order = tree.order().to_vec();
        order.sort_unstable();
        prop_assert!(order.into_iter().eq(0..count as u32));
    }
}

#[test]
fn a_request_to_stop_stops() {
    let points: Vec<f64> = (0..3000).map(f64::from).collect();
    let control = Control::default();
    let tree = KdTree::new(&points, 3, &control).unwrap();
    control.stop();
    assert_eq!(tree.nearest(&points, 3, &control), Err(Error::Cancelled));
    assert_eq!(tree.within(&points, 3.0, usize::MAX, &control), Err(Error::Cancelled));
}

#[test]
fn wrong_input_is_an_error() {
    let control = Control::default();
    assert!(matches!(KdTree::new(&[1.0, 2.0, 3.0], 2, &control), Err(Error::Input(_))));
    assert!(matches!(KdTree::new(&[1.0, f64::NAN], 2, &control), Err(Error::Input(_))));
    let empty = KdTree::new(&[], 3, &control).unwrap();
    assert!(matches!(empty.nearest(&[0.0; 3], 1, &control), Err(Error::Input(_))));
    assert_eq!(empty.within(&[0.0; 3], 1.0, usize::MAX, &control).unwrap().starts, [0, 0]);
    assert!(matches!(empty.within(&[0.0; 3], f64::NAN, usize::MAX, &control), Err(Error::Input(_))));
}

/// Distance to a triangle by minimizing over barycentric coordinates: a grid, then ever finer ones around the best (the problem
/// is convex).
fn refined(query: &[f64], corners: [&[f64]; 3]) -> f64 {
    let at = |u: f64, v: f64| {
        let w = 1.0 - u - v;
        (0..query.len()).map(|k| (query[k] - u * corners[0][k] - v * corners[1][k] - w * corners[2][k]).powi(2)).sum::<f64>().sqrt()
    };
    let (mut best, mut step) = ((1.0 / 3.0, 1.0 / 3.0, at(1.0 / 3.0, 1.0 / 3.0)), 0.25);
    for _ in 0..60 {
        let (x, y, _) = best;
        for i in -8..=8 {
            for j in -8..=8 {
                let u = (x + step * f64::from(i) / 4.0).clamp(0.0, 1.0);
                let v = (y + step * f64::from(j) / 4.0).clamp(0.0, 1.0 - u);
                let distance = at(u, v);
                if distance < best.2 {
                    best = (u, v, distance);
                }
            }
        }
        step *= 0.7;
    }
    best.2
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]
    #[test]
    fn closest_points_are_those_of_brute_force(numbers in prop::collection::vec(-3.0..3.0f64, 9 * 12), queries in prop::collection::vec(-6.0..6.0f64, 12)) {
        let faces: Vec<[u32; 3]> = (0..12).map(|face| [3 * face, 3 * face + 1, 3 * face + 2]).collect();
        let mesh = TriangleMesh::new(3, &numbers[..], &faces[..]).unwrap();
        let bvh = Bvh::new(&mesh, &Control::default()).unwrap();
        let found = bvh.closest(&queries, &Control::default()).unwrap();
        for (index, query) in queries.chunks(3).enumerate() {
            let corners = |face: u32| [3 * face, 3 * face + 1, 3 * face + 2].map(|corner| mesh.vertex(corner));
            let best = (0..12).map(|face| refined(query, corners(face))).fold(f64::INFINITY, f64::min);
            prop_assert!((found.distances[index] - best).abs() < 1e-5, "{} {best}", found.distances[index]);
            prop_assert!(found.distances[index] <= best + 1e-12);
        }
    }
}

#[test]
fn meshes_and_rays_that_cannot_be_used_are_errors() {
    let control = Control::default();
    let flat = TriangleMesh::new(2, vec![0.0, 0.0, 1.0, 0.0, 0.0, 1.0], vec![[0, 1, 2]]).unwrap();
    let bvh = Bvh::new(&flat, &control).unwrap();
    assert!(matches!(bvh.intersect(&[0.0; 2], &[1.0; 2], &control), Err(Error::Input(_))));
    assert!(matches!(bvh.closest(&[f64::INFINITY; 2], &control), Err(Error::Input(_))));
    assert_eq!(bvh.closest(&[], &control).unwrap().distances, []);
    let none = TriangleMesh::new(2, vec![0.0, 0.0], vec![]).unwrap();
    assert!(matches!(Bvh::new(&none, &control), Err(Error::Input(_))));
    assert!(matches!(beltrami::near::normals(&[0.0; 30], 3, 4, &control), Err(Error::Input(_))));
    control.stop();
    assert_eq!(bvh.closest(&[0.0; 2], &control), Err(Error::Cancelled));
}
