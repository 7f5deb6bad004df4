//! Neighbours, closest points and rays against brute force.

use beltrami::near::{KdTree, Scratch};
use beltrami::{Control, Error};
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
        dimension in 1usize..6,
        numbers in prop::collection::vec(prop_oneof![(-3i32..4).prop_map(f64::from), -3.0..3.0f64], 6..600),
        share in 0.0..1.0f64,
        radius in 0.0..4.0f64,
    ) {
        let points = &numbers[..numbers.len() / dimension * dimension];
        let count = points.len() / dimension;
        let wanted = 1 + (share * (count - 1) as f64) as usize;
        let tree = KdTree::new(points, dimension, &Control::default()).unwrap();
        let (indices, distances) = tree.nearest(points, wanted, &Control::default()).unwrap();
        let near = tree.within(points, radius, &Control::default()).unwrap();
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
    assert_eq!(tree.within(&points, 3.0, &control), Err(Error::Cancelled));
}

#[test]
fn wrong_input_is_an_error() {
    let control = Control::default();
    assert!(matches!(KdTree::new(&[1.0, 2.0, 3.0], 2, &control), Err(Error::Input(_))));
    assert!(matches!(KdTree::new(&[1.0, f64::NAN], 2, &control), Err(Error::Input(_))));
    let empty = KdTree::new(&[], 3, &control).unwrap();
    assert!(matches!(empty.nearest(&[0.0; 3], 1, &control), Err(Error::Input(_))));
    assert_eq!(empty.within(&[0.0; 3], 1.0, &control).unwrap().starts, [0, 0]);
    assert!(matches!(empty.within(&[0.0; 3], f64::NAN, &control), Err(Error::Input(_))));
}
