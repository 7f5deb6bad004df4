//! The spectrum of the sphere: l (l + 1), 2 l + 1 times, each value with its residual.
//!
//! `cargo run --release --example spectrum`

use beltrami::operators::cotangent_operators;
use beltrami::solvers::{EigenOptions, Mass, eigenpairs};
use beltrami::{Control, Result, shape::make};

/// Prints a table, and holds every value against the closed form.
pub fn main() -> Result<()> {
    let sphere = make::sphere(24, 1.0)?;
    let operators = cotangent_operators(&sphere)?;
    let options = EigenOptions { coordinates: Some((sphere.vertices(), 3)), ..Default::default() };
    let found = eigenpairs(&operators.stiffness, Mass::Diagonal(&operators.mass), 16, &options, &Control::default())?;
    println!("{:>3} {:>10} {:>6} {:>9}", "k", "value", "exact", "residual");
    for (k, (value, residual)) in found.values.iter().zip(&found.residuals).enumerate() {
        let degree = (k as f64).sqrt().floor();
        let exact = degree * (degree + 1.0);
        println!("{k:>3} {value:>10.5} {exact:>6} {residual:>9.1e}");
        assert!((value - exact).abs() < 0.01 * exact.max(1.0));
    }
    Ok(())
}
