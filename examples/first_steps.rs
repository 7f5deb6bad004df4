//! Load a surface (or make one), and take its area, its first eigenvalues and the distances from a vertex.
//!
//! `cargo run --release --example first_steps [FILE]`

use beltrami::geodesic::HeatMethod;
use beltrami::operators::cotangent_operators;
use beltrami::solvers::{EigenOptions, Mass, eigenpairs};
use beltrami::{Control, io, shape::make};

fn main() -> beltrami::Result<()> {
    let control = Control::default(); // progress and cancelling
    let mesh = match std::env::args().nth(1) {
        Some(file) => io::load(file)?.into_mesh()?,
        None => make::torus(1.0, 0.4, 60, 24)?,
    };
    let operators = cotangent_operators(&mesh)?;
    let modes = eigenpairs(&operators.stiffness, Mass::Diagonal(&operators.mass), 6, &EigenOptions::default(), &control)?;
    let distance = HeatMethod::on_mesh(&mesh, 1.0, &control)?.distance(&[0], &control)?;
    println!("area {:.4}, eigenvalues {:.4?}", mesh.area(), modes.values);
    println!("largest residual {:.1e}", modes.residuals.iter().fold(0.0, |a: f64, &b| a.max(b)));
    println!("farthest from vertex 0: {:.4}", distance.iter().fold(0.0, |a: f64, &b| a.max(b)));
    Ok(())
}
