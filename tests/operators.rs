//! Operators, eigenpairs and distances of meshes for those who use the crate alone.

use beltrami::geodesic::HeatMethod;
use beltrami::operators::{cotangent_operators, divergence, gradient, voronoi_mass};
use beltrami::shape::make;
use beltrami::solvers::{EigenOptions, Mass, eigenpairs};
use beltrami::{Control, Csr, Error, TriangleMesh};
use proptest::prelude::*;

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

/// Dirichlet energy of a linear function on a flat sheet: slope squared times area, whatever the triangles.
#[test]
fn energy_of_a_linear_function() {
    let mesh = make::grid(3.0, 2.0, 9, 6).unwrap();
    let operators = cotangent_operators(&mesh).unwrap();
    let f: Vec<f64> = mesh.vertices().chunks(mesh.dimension()).map(|p| 2.0 * p[0] - 3.0 * p[1]).collect();
    let energy = dot(&f, &operators.stiffness.multiply(&f).unwrap());
    assert!((energy - 13.0 * 6.0).abs() < 1e-11, "{energy}");
    assert!((voronoi_mass(&mesh).unwrap().iter().sum::<f64>() - 6.0).abs() < 1e-13);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    /// Symmetric to the last bit, rows sum to zero, L = G^T A G and div = -M^-1 G^T A on random sheets in R^2 to R^4.
    #[test]
    fn identities(dimension in 2usize..5, moves in prop::collection::vec(-0.3f64..0.3, 4 * 30), values in prop::collection::vec(-1.0f64..1.0, 30)) {
        let sheet = make::grid(5.0, 4.0, 6, 5).unwrap();
        let flat = sheet.dimension();
        let vertices: Vec<f64> = (0..30)
            .flat_map(|i| (0..dimension).map(move |d| (i, d)))
            .map(|(i, d)| if d < 2 { sheet.vertices()[flat * i + d] } else { 0.0 } + 0.5 * moves[4 * i + d])
            .collect();
        let mesh = TriangleMesh::new(dimension, vertices, sheet.faces().to_vec()).unwrap();
        let operators = cotangent_operators(&mesh).unwrap();
        prop_assert_eq!(&operators.stiffness, &operators.stiffness.transpose());
        let scale = operators.stiffness.values().iter().fold(0.0f64, |a, b| a.max(b.abs()));
        for row in 0..30 {
            prop_assert!(operators.stiffness.row(row).1.iter().sum::<f64>().abs() <= 1e-14 * scale);
        }
        let image = operators.stiffness.multiply(&values).unwrap();
        let slope = gradient(&mesh).unwrap().multiply(&values).unwrap();
        let back = divergence(&mesh, &operators.mass).unwrap().multiply(&slope).unwrap();
        for ((image, back), mass) in image.iter().zip(&back).zip(&operators.mass) {
            prop_assert!((image + mass * back).abs() <= 1e-11 * scale);
        }
        prop_assert!(dot(&values, &image) >= -1e-12 * scale);
    }
}

#[test]
fn degenerate_triangles_are_named() {
    let mesh = TriangleMesh::new(2, vec![0.0, 0.0, 1.0, 0.0, 2.0, 0.0, 0.0, 1.0], vec![[0, 1, 3], [0, 1, 2]]).unwrap();
    let Err(Error::Input(text)) = cotangent_operators(&mesh) else { panic!("accepted") };
    assert!(text.starts_with("face 1 ([0, 1, 2]) is degenerate"), "{text}");
}

/// The cycle of n points: 2 - 2 cos(2 π j / n), each but the ends twice.
#[test]
fn eigenvalues_of_a_cycle() {
    let n = 500u32;
    let (mut starts, mut indices, mut values) = (vec![0], Vec::new(), Vec::new());
    for i in 0..n {
        let mut row = [((i + n - 1) % n, -1.0), (i, 2.0), ((i + 1) % n, -1.0)];
        row.sort_by_key(|entry| entry.0);
        for (column, value) in row {
            indices.push(column);
            values.push(value);
        }
        starts.push(indices.len());
    }
    let cycle = Csr::new(n as usize, n as usize, starts, indices, values).unwrap();
    let ones = vec![1.0; n as usize];
    let found = eigenpairs(&cycle, Mass::Diagonal(&ones), 21, &EigenOptions::default(), &Control::default()).unwrap();
    for (k, value) in found.values.iter().enumerate() {
        let exact = 2.0 - 2.0 * (std::f64::consts::TAU * k.div_ceil(2) as f64 / f64::from(n)).cos();
        assert!((value - exact).abs() < 1e-12, "{k}: {value} for {exact}");
    }
}

#[test]
fn eigenpairs_can_be_stopped() {
    let mesh = make::sphere(20, 1.0).unwrap();
    let operators = cotangent_operators(&mesh).unwrap();
    let control = Control::default();
    control.stop();
    let stopped = eigenpairs(&operators.stiffness, Mass::Diagonal(&operators.mass), 10, &EigenOptions::default(), &control);
    assert_eq!(stopped.unwrap_err(), Error::Cancelled);
}

/// Straight lines on a sheet, its boundary included.
#[test]
fn distances_on_a_sheet() {
    let mesh = make::grid(1.0, 1.0, 41, 41).unwrap();
    let heat = HeatMethod::on_mesh(&mesh, 1.0, &Control::default()).unwrap();
    let distance = heat.distance(&[20 * 41 + 20], &Control::default()).unwrap();
    let centre = mesh.vertex(20 * 41 + 20).to_vec();
    for (point, distance) in mesh.vertices().chunks(mesh.dimension()).zip(&distance) {
        let exact = point.iter().zip(&centre).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt();
        assert!((distance - exact).abs() < 1.0 / 40.0, "{distance} for {exact}");
    }
    assert!(heat.distance(&[], &Control::default()).is_err());
    assert!(heat.distance(&[41 * 41], &Control::default()).is_err());
}

#[test]
fn matrices_too_large_are_refused() {
    let huge = 1usize << 32;
    assert!(matches!(Csr::new(1, huge, vec![0, 1], vec![u32::MAX], vec![1.0]), Err(Error::Input(_))));
    assert!(matches!(Csr::new(usize::MAX, 1, vec![], vec![], vec![]), Err(Error::Input(_))));
    let widest = Csr::new(1, huge - 1, vec![0, 1], vec![u32::MAX - 1], vec![1.0]).unwrap();
    assert_eq!(widest.combine(1.0, &widest, 2.0).unwrap().values(), [3.0]);
}
