//! Times of the kernels on spheres of 10k and 100k vertices: `cargo bench`.

#![allow(missing_docs)] // criterion's macro makes a public function

use beltrami::geodesic::HeatMethod;
use beltrami::near::KdTree;
use beltrami::operators::{cotangent_operators, gradient};
use beltrami::shape::{intrinsic_delaunay, make};
use beltrami::solvers::{Cholesky, EigenOptions, Mass, eigenpairs};
use beltrami::{Control, Csr};
use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use std::hint::black_box;

fn kernels(c: &mut Criterion) {
    let control = Control::default();
    for frequency in [32, 100] {
        let mesh = make::sphere(frequency, 1.0).unwrap();
        let n = mesh.vertex_count();
        let operators = cotangent_operators(&mesh).unwrap();
        let places = Some((mesh.vertices(), 3));
        let matrix = operators.stiffness.combine(1.0, &Csr::from_diagonal(&operators.mass), 1.0).unwrap();
        let factor = Cholesky::new(&matrix, places, &control).unwrap();
        let heat = HeatMethod::on_mesh(&mesh, 1.0, &control).unwrap();
        let block = vec![1.0; 32 * n];
        let mut group = c.benchmark_group(format!("sphere/{n}"));
        group.sample_size(10);
        group.bench_function("cotangent operators", |b| b.iter(|| cotangent_operators(black_box(&mesh))));
        group.bench_function("gradient", |b| b.iter(|| gradient(black_box(&mesh))));
        group.bench_function("intrinsic Delaunay", |b| b.iter(|| intrinsic_delaunay(black_box(&mesh), &control)));
        group.bench_function("Cholesky", |b| b.iter(|| Cholesky::new(black_box(&matrix), places, &control)));
        group.bench_function("32 right-hand sides", |b| b.iter(|| factor.solve_block(black_box(&block), 32)));
        group.bench_function("distance, factors kept", |b| b.iter(|| heat.distance(black_box(&[0]), &control)));
        group.bench_function("16 neighbours of every vertex", |b| {
            b.iter(|| KdTree::new(black_box(mesh.vertices()), 3, &control).and_then(|tree| tree.nearest(mesh.vertices(), 16, &control)))
        });
        if frequency == 32 {
            let options = EigenOptions { coordinates: places, ..Default::default() };
            group.bench_with_input(BenchmarkId::new("eigenpairs", 50), &50, |b, &k| {
                b.iter(|| eigenpairs(&operators.stiffness, Mass::Diagonal(&operators.mass), k, &options, &control))
            });
        }
        group.finish();
    }
}

criterion_group!(benches, kernels);
criterion_main!(benches);
