//! The examples run and hold what they print against closed forms.

#[path = "../examples/distances.rs"]
mod distances;
#[path = "../examples/poisson.rs"]
mod poisson;
#[path = "../examples/spectrum.rs"]
mod spectrum;

#[test]
fn distances_run() {
    distances::main().unwrap();
}

#[test]
fn poisson_runs() {
    poisson::main().unwrap();
}

#[test]
fn spectrum_runs() {
    spectrum::main().unwrap();
}
