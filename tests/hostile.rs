//! Any points and any triangles between them: operators, distances and searches answer with finite numbers or with an error.

use beltrami::geodesic::HeatMethod;
use beltrami::levelset::level_set;
use beltrami::near::{Bvh, KdTree, farthest_points, normals};
use beltrami::operators::{
    LocalMeshOptions, MlsOptions, VotedSimplices, cotangent_operators, divergence, galerkin_mass, gradient, local_mesh,
    moving_least_squares, voronoi_mass,
};
use beltrami::shape::{IntrinsicTriangulation, Topology, intrinsic_delaunay, tufted};
use beltrami::solvers::{EigenOptions, LaplacianSolver, Mass, eigenpairs};
use beltrami::{Control, Csr, Error, Result, TriangleMesh};
use proptest::prelude::*;

/// Numbers from where arithmetic is easily lost.
fn coordinate() -> impl Strategy<Value = f64> {
    prop_oneof![
        8 => -1.0..1.0f64,
        4 => (-2i32..3).prop_map(f64::from), // many at the same place, on one line, in one plane
        1 => (-1.0..1.0f64, -320i32..309).prop_map(|(share, power)| share * 10f64.powi(power)),
    ]
}

fn points(most: usize) -> impl Strategy<Value = (usize, Vec<f64>)> {
    let scale = prop_oneof![4 => Just(0), 1 => -310i32..300];
    (2usize..6, 1..most, scale).prop_flat_map(|(dimension, count, power)| {
        prop::collection::vec(coordinate(), dimension * count)
            .prop_map(move |numbers| (dimension, numbers.iter().map(|number| number * 10f64.powi(power)).collect()))
    })
}

/// A strip or a fan or triangles at random, some of them turned, repeated, or with corners that coincide.
fn soup() -> impl Strategy<Value = (usize, Vec<f64>, Vec<[u32; 3]>)> {
    points(40).prop_flat_map(|(dimension, vertices)| {
        let count = (vertices.len() / dimension) as u32;
        let random = prop::collection::vec([0..count, 0..count, 0..count], 0..60);
        let shift = move |i: u32, by: u32| (i + by) % count;
        let strip = (0..count).prop_map(move |n| {
            (0..n).map(|i| if i % 2 == 0 { [i, shift(i, 1), shift(i, 2)] } else { [shift(i, 1), i, shift(i, 2)] }).collect::<Vec<_>>()
        });
        let fan = (0..count).prop_map(move |n| (1..n).map(|i| [0, i, shift(i, 1)]).collect::<Vec<_>>());
        let faces = prop_oneof![random.clone(), (strip, random.clone()).prop_map(|(a, b)| [a, b].concat()), fan];
        (Just(dimension), Just(vertices), faces)
    })
}

fn finite(what: &str, numbers: &[f64]) {
    let at = numbers.iter().position(|number| !number.is_finite());
    assert!(at.is_none(), "{what}: number {at:?} is {}", numbers[at.unwrap_or_default()]);
}

/// The answer, which must be finite, or nothing if it was refused in words.
fn answer<T>(what: &str, outcome: Result<T>, numbers: impl Fn(&T) -> Vec<f64>) -> Option<T> {
    match outcome {
        Ok(found) => {
            finite(what, &numbers(&found));
            Some(found)
        }
        Err(Error::Cancelled) => panic!("{what}: nobody asked to stop"),
        Err(error) => {
            assert!(error.to_string().len() > 10, "{what}: {error}");
            None
        }
    }
}

fn entries(matrix: &Csr) -> Vec<f64> {
    matrix.values().to_vec()
}

/// What stands on stiffness and mass, however those were found.
fn solved(what: &str, stiffness: &Csr, mass: &[f64]) {
    let control = Control::default();
    let n = mass.len();
    let right: Vec<f64> = (0..n).map(|i| ((i * 7) % 5) as f64 - 2.0).collect();
    answer(what, LaplacianSolver::new(stiffness, mass, None, &control).and_then(|solver| solver.solve(&right, 1, &control)), Vec::clone);
    answer(what, eigenpairs(stiffness, Mass::Diagonal(mass), n.min(4), &EigenOptions::default(), &control), |pairs| {
        [pairs.values.clone(), pairs.vectors.clone()].concat()
    });
}

fn cases(usual: u32) -> ProptestConfig {
    let cases = std::env::var("PROPTEST_CASES").map_or(usual, |_| ProptestConfig::default().cases);
    ProptestConfig { cases, failure_persistence: None, ..ProptestConfig::default() }
}

fn intrinsic(what: &str, triangulation: &IntrinsicTriangulation) {
    let mass = triangulation.mass();
    finite(what, &mass);
    finite(what, &triangulation.voronoi_mass());
    finite(what, triangulation.stiffness().values());
    finite(what, triangulation.gradient().values());
    answer(what, triangulation.divergence(&mass), entries);
    solved(what, &triangulation.stiffness(), &mass);
}

proptest! {
    #![proptest_config(cases(400))]

    #[test]
    fn any_triangles((dimension, vertices, faces) in soup(), numbers in prop::collection::vec(coordinate(), 40)) {
        let control = Control::default();
        let Ok(mesh) = TriangleMesh::new(dimension, vertices, faces) else { return Ok(()) };
        let n = mesh.vertex_count();
        if let Some(operators) = answer("cotangents", cotangent_operators(&mesh), |found| [entries(&found.stiffness), found.mass.clone()].concat()) {
            answer("divergence", divergence(&mesh, &operators.mass), entries);
            solved("cotangents", &operators.stiffness, &operators.mass);
        }
        answer("gradient", gradient(&mesh), entries);
        answer("Voronoi", voronoi_mass(&mesh), Vec::clone);
        answer("Galerkin", galerkin_mass(&mesh), entries);
        if let Some(found) = answer("Delaunay", intrinsic_delaunay(&mesh, &control), |found| found.lengths()) {
            intrinsic("Delaunay", &found);
        }
        if let Some(found) = answer("tufted", tufted(&mesh, &control), |found| found.lengths()) {
            intrinsic("tufted", &found);
        }
        if let Some(heat) = answer("heat", HeatMethod::on_mesh(&mesh, 1.0, &control), |_| vec![])
            && let Ok(distance) = heat.distance(&[0], &control)
        {
            prop_assert!(distance.iter().all(|distance| *distance >= 0.0), "{:?}", distance); // infinite where nothing reaches
        }
        if let Ok(topology) = Topology::new(&mesh) {
            topology.components();
            topology.non_manifold_vertices();
            topology.boundary_loops();
            answer("genus", topology.genus(), |_| vec![]);
            answer("orientation", topology.oriented_faces(), |_| vec![]);
        }
        answer("contours", level_set(&mesh, &numbers[..n.min(numbers.len())], 0.0), |found| found.shares.clone());
        if let Some(tree) = answer("tree of boxes", Bvh::new(&mesh, &control), |_| vec![]) {
            answer("closest", tree.closest(&numbers[..dimension * 4], &control), |found| [found.points.clone(), found.distances.clone()].concat());
            answer("rays", tree.intersect(&numbers[..6], &numbers[6..12], &control), |_| vec![]);
        }
    }

    #[test]
    fn any_points((ambient, points) in points(120), dimension in 1usize..4) {
        let control = Control::default();
        let n = points.len() / ambient;
        if let Some(mls) = answer(
            "least squares",
            moving_least_squares(&points, ambient, dimension, &MlsOptions::default(), &control),
            |found| [entries(&found.gradient), entries(&found.laplacian)].concat(),
        ) {
            prop_assert_eq!(mls.laplacian.rows(), n);
        }
        if let Some(mesh) = answer("stars", local_mesh(&points, ambient, dimension, &LocalMeshOptions::default(), &control), |found| {
            [&found.spacing[..], &found.frames, &found.curvature, &found.stretch].concat()
        }) {
            let view = VotedSimplices::new(&points, ambient, mesh.dimension, &mesh.simplices, &mesh.votes).and_then(|view| view.stretched(&mesh.stretch));
            if let Some(view) = answer("voted simplices", view, |_| vec![]) {
                let (mass, stiffness) = (answer("mass", view.mass(), Vec::clone), answer("stiffness", view.stiffness(), entries));
                answer("gradient of a cloud", view.gradient(), entries);
                if let (Some(mass), Some(stiffness)) = (mass, stiffness) {
                    solved("cloud", &stiffness, &mass);
                }
            }
        }
        answer("normals", normals(&points, ambient, n.min(12), &control), Vec::clone);
        answer("farthest", farthest_points(&points, ambient, n.min(7), 0, &control), |_| vec![]);
        if let Some(tree) = answer("tree of points", KdTree::new(&points, ambient, &control), |_| vec![]) {
            answer("nearest", tree.nearest(&points, n.min(5), &control), |(_, distances)| distances.clone());
        }
    }
}
