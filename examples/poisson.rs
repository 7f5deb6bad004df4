//! A Poisson equation on a closed surface with one kept factor: -Δu = f for several f.
//!
//! `cargo run --release --example poisson`

use beltrami::operators::cotangent_operators;
use beltrami::solvers::LaplacianSolver;
use beltrami::{Control, Result, shape::make};

/// On the unit sphere f = x, y, z have u = f / 2.
pub fn main() -> Result<()> {
    let sphere = make::sphere(40, 1.0)?;
    let operators = cotangent_operators(&sphere)?;
    let solver = LaplacianSolver::new(&operators.stiffness, &operators.mass, Some((sphere.vertices(), 3)), &Control::default())?;
    let right: Vec<f64> = sphere.vertices().chunks(3).zip(&operators.mass).flat_map(|(p, m)| p.iter().map(move |x| m * x)).collect();
    let u = solver.solve(&right, 3, &Control::default())?;
    let error = u.iter().zip(sphere.vertices()).map(|(u, x)| (u - x / 2.0).abs()).fold(0.0, f64::max);
    println!("largest error {error:.1e} at {} vertices", sphere.vertex_count());
    assert!(error < 1e-3);
    Ok(())
}
