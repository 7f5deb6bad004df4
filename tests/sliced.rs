//! Sliced Wasserstein distances against closed forms.

use beltrami::sliced::{self, Alignment};
use beltrami::{Control, Error};
use proptest::prelude::*;

/// Optimal cost on a line between equally many points of equal weight: sorted against sorted.
fn sorted_cost(mut x: Vec<f64>, mut y: Vec<f64>) -> f64 {
    x.sort_by(f64::total_cmp);
    y.sort_by(f64::total_cmp);
    x.iter().zip(&y).map(|(a, b)| (a - b) * (a - b)).sum::<f64>() / x.len() as f64
}

fn repeat(values: &[f64], times: usize) -> Vec<f64> {
    values.iter().flat_map(|&value| std::iter::repeat_n(value, times)).collect()
}

proptest! {
    /// Measures of n and m points are those of n m points, each repeated; whole weights are repetitions.
    #[test]
    fn weights_and_sizes_are_repetitions(
        x in prop::collection::vec(-5.0..5.0f64, 1..40),
        y in prop::collection::vec(prop_oneof![(-3i32..4).prop_map(f64::from), -5.0..5.0f64], 1..40),
        seed in 0usize..7,
    ) {
        let control = Control::default();
        let exact = sorted_cost(repeat(&x, y.len()), repeat(&y, x.len())).sqrt();
        let got = sliced::distance(&x, &y, 1, None, None, &[-1.0], &control).unwrap();
        prop_assert!((got - exact).abs() <= 1e-12 * (1.0 + exact));
        let weights: Vec<f64> = (0..x.len()).map(|i| ((i * 5 + seed) % 3 + 1) as f64).collect();
        let heavy: Vec<f64> = x.iter().zip(&weights).flat_map(|(&value, &weight)| repeat(&[value], weight as usize)).collect();
        let exact = sorted_cost(repeat(&heavy, y.len()), repeat(&y, heavy.len())).sqrt();
        let got = sliced::distance(&x, &y, 1, Some(&weights), None, &[1.0], &control).unwrap();
        prop_assert!((got - exact).abs() <= 1e-12 * (1.0 + exact));
        let got = sliced::distance(&y, &x, 1, None, Some(&weights), &[1.0], &control).unwrap();
        prop_assert!((got - exact).abs() <= 1e-12 * (1.0 + exact));
    }

    /// At a rotation R the value is the squared distance of X R and Y.
    #[test]
    fn a_step_evaluates_the_distance(
        x in prop::collection::vec(-5.0..5.0f64, 2..200),
        y in prop::collection::vec(-5.0..5.0f64, 2..200),
        angle in 0.0..6.0f64,
    ) {
        let (x, y) = (&x[..x.len() / 2 * 2], &y[..y.len() / 2 * 2]);
        let (s, c) = angle.sin_cos();
        let turned: Vec<f64> = x.chunks(2).flat_map(|p| [c * p[0] - s * p[1], s * p[0] + c * p[1]]).collect();
        let directions = [0.6, 0.8, -0.8, 0.6];
        let control = Control::default();
        let distance = sliced::distance(&turned, y, 2, None, None, &directions, &control).unwrap();
        let alignment = Alignment::new(x, y, 2, None, None, &directions, &control).unwrap();
        let value = alignment.step(&[c, s, -s, c], &control).unwrap()[0].value;
        prop_assert!((value.sqrt() - distance).abs() <= 1e-12 * (1.0 + distance));
    }
}

#[test]
fn wrong_input_is_an_error() {
    let control = Control::default();
    let input = |result: Result<f64, Error>| assert!(matches!(result, Err(Error::Input(_))), "{result:?}");
    let (x, way) = ([0.0, 1.0, 2.0, 3.0], [1.0, 0.0]);
    input(sliced::distance(&x, &[], 2, None, None, &way, &control));
    input(sliced::distance(&x, &x[..3], 2, None, None, &way, &control));
    input(sliced::distance(&x, &[f64::NAN, 0.0], 2, None, None, &way, &control));
    input(sliced::distance(&x, &x, 2, Some(&[1.0]), None, &way, &control));
    input(sliced::distance(&x, &x, 2, Some(&[1.0, -1.0]), None, &way, &control));
    input(sliced::distance(&x, &x, 2, None, None, &[1.0, 1.0], &control));
    input(sliced::distance(&x, &x, 2, None, None, &[], &control));
    let huge = [1e200, 0.0];
    assert!(matches!(sliced::distance(&x, &huge, 2, None, None, &way, &control), Err(Error::Numerical(_))));
    let alignment = Alignment::new(&x, &x, 2, None, None, &way, &control).unwrap();
    assert!(alignment.step(&[1.0, 0.0, 0.0], &control).is_err());
    control.stop();
    assert_eq!(alignment.step(&[1.0, 0.0, 0.0, 1.0], &control), Err(Error::Cancelled));
}
