//! Intrinsic Delaunay triangulations and tufted covers.

use beltrami::shape::{IntrinsicTriangulation, intrinsic_delaunay, make, tufted};
use beltrami::{Control, Csr, Error, TriangleMesh};
use proptest::prelude::*;

fn delaunay(mesh: &TriangleMesh<'_>) -> IntrinsicTriangulation {
    intrinsic_delaunay(mesh, &Control::default()).unwrap()
}

fn cover(mesh: &TriangleMesh<'_>) -> IntrinsicTriangulation {
    tufted(mesh, &Control::default()).unwrap()
}

/// Largest entry off the diagonal over the largest absolute one, asymmetry, row sums over the same.
fn figures(stiffness: &Csr) -> (f64, usize, f64) {
    let transposed = stiffness.transpose();
    let unequal = stiffness.values().iter().zip(transposed.values()).filter(|(a, b)| a != b).count()
        + usize::from(stiffness.indices() != transposed.indices());
    let (mut largest, mut size, mut sums) = (f64::NEG_INFINITY, 0f64, 0f64);
    for row in 0..stiffness.rows() {
        let (columns, values) = stiffness.row(row);
        sums = sums.max(values.iter().sum::<f64>().abs());
        for (&column, &value) in columns.iter().zip(values) {
            assert!(value.is_finite());
            if column as usize != row {
                largest = largest.max(value);
                size = size.max(value.abs());
            }
        }
    }
    (largest / size, unequal, sums / size)
}

fn sound(triangulation: &IntrinsicTriangulation) {
    let stiffness = triangulation.stiffness();
    let (largest, unequal, sums) = figures(&stiffness);
    assert!(largest <= 1e-12, "an entry off the diagonal is {largest} of the largest");
    assert_eq!(unequal, 0);
    assert!(sums <= 1e-13, "row sums {sums}");
    let mass = triangulation.mass();
    let total: f64 = triangulation.face_areas().iter().sum();
    assert!((mass.iter().sum::<f64>() / total - 1.0).abs() < 1e-12);
    // G^T A G = L, and the divergence is the adjoint, both tried on a rough function
    let n = triangulation.vertex_count();
    let f: Vec<f64> = (0..n).map(|i| ((i * 7919 + 13) % 101) as f64 / 101.0).collect();
    let gradient = triangulation.gradient().multiply(&f).unwrap();
    let source = triangulation.divergence(&mass).unwrap().multiply(&gradient).unwrap();
    let flow = stiffness.multiply(&f).unwrap();
    let size = flow.iter().fold(0.0, |a: f64, b| a.max(b.abs()));
    for ((source, mass), flow) in source.iter().zip(&mass).zip(&flow) {
        assert!((source * mass + flow).abs() <= 1e-9 * size, "{} against {flow} of {size}", source * mass);
    }
}

#[test]
fn stretched_closed_shapes_get_weights_of_one_sign() {
    let control = Control::default();
    for mesh in [
        make::ellipsoid(12, [1.0, 0.6, 0.15]).unwrap(),
        make::ellipsoid(12, [1.0, 0.01, 1.0]).unwrap(),
        make::ellipsoid(7, [100.0, 1.0, 0.3]).unwrap(),
        make::torus(1.0, 0.2, 80, 9).unwrap(),
        make::flat_torus(1.0, 0.02, 60, 8).unwrap(),
        make::knot(2, 3, [1.0, 0.45, 0.16], 60, 40).unwrap(),
        make::figure_eight([1.0, 0.35], 6, &control).unwrap(),
    ] {
        let triangulation = delaunay(&mesh);
        assert!((triangulation.face_areas().iter().sum::<f64>() / mesh.area() - 1.0).abs() < 1e-9);
        sound(&triangulation);
        sound(&cover(&mesh));
    }
}

#[test]
fn a_regular_sphere_stays_as_it_is_and_its_cover_says_the_same() {
    let mesh = make::sphere(8, 1.0).unwrap();
    let (plain, double) = (delaunay(&mesh), cover(&mesh));
    assert_eq!((plain.flips(), plain.mollified(), double.flips()), (0, 0, 0));
    assert_eq!(plain.faces(), mesh.faces());
    let (one, other) = (plain.stiffness(), double.stiffness());
    assert_eq!(one.indices(), other.indices());
    for (a, b) in one.values().iter().zip(other.values()) {
        assert!((a - b).abs() < 1e-14);
    }
}

#[test]
fn planar_triangulations_become_the_delaunay_triangulation() {
    // A jittered strip, triangulated with every diagonal the wrong way: by the empty-circle test no edge is bad afterwards,
    // and a linear function keeps its energy and its harmonicity inside.
    let (rows, columns) = (17, 11);
    let mut vertices = Vec::new();
    for i in 0..rows {
        for j in 0..columns {
            let jitter = |salt: usize| ((i * 131 + j * 71 + salt) * 2654435761 % 1000) as f64 / 1000.0 - 0.5;
            let inside = i > 0 && j > 0 && i + 1 < rows && j + 1 < columns;
            let push = if inside { 0.5 } else { 0.0 };
            vertices.extend([i as f64 + push * jitter(1) + 0.8 * j as f64, j as f64 + push * jitter(2)]);
        }
    }
    let mut faces = Vec::new();
    for i in 0..rows - 1 {
        for j in 0..columns - 1 {
            let at = |i: usize, j: usize| (i * columns + j) as u32;
            let (a, b, c, d) = (at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1));
            faces.extend([[a, b, c], [a, c, d]]);
        }
    }
    let mesh = TriangleMesh::new(2, vertices, faces).unwrap();
    let triangulation = delaunay(&mesh);
    assert!(triangulation.flips() > 100);
    assert!((triangulation.face_areas().iter().sum::<f64>() / mesh.area() - 1.0).abs() < 1e-12);
    let place = |v: u32| [mesh.vertex(v)[0], mesh.vertex(v)[1]];
    for (face, corners) in triangulation.faces().iter().enumerate() {
        for k in 0..3 {
            let h = (3 * face + k) as u32;
            let [p, q] = [place(corners[k]), place(corners[(k + 1) % 3])];
            let length = (p[0] - q[0]).hypot(p[1] - q[1]);
            assert!((triangulation.lengths()[h as usize] - length).abs() < 1e-12 * (1.0 + length), "edges are straight");
            let Some(twin) = triangulation.twin(h) else { continue };
            let d = place(triangulation.faces()[twin as usize / 3][(twin as usize % 3 + 2) % 3]);
            let [a, b, c] = corners.map(place).map(|p| [p[0] - d[0], p[1] - d[1], (p[0] - d[0]).powi(2) + (p[1] - d[1]).powi(2)]);
            let inside = a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0]) + a[2] * (b[0] * c[1] - b[1] * c[0]);
            assert!(inside <= 1e-10, "a corner in a circle: {inside}");
        }
    }
    let x: Vec<f64> = (0..mesh.vertex_count() as u32).map(|v| mesh.vertex(v)[0]).collect();
    let flow = triangulation.stiffness().multiply(&x).unwrap();
    let energy: f64 = x.iter().zip(&flow).map(|(x, f)| x * f).sum();
    assert!((energy / mesh.area() - 1.0).abs() < 1e-12);
}

#[test]
fn degenerate_triangles_become_finite() {
    let base = make::sphere(5, 1.0).unwrap();
    let spoil = |change: &dyn Fn(&mut Vec<f64>, &mut Vec<[u32; 3]>)| {
        let (mut vertices, mut faces) = (base.vertices().to_vec(), base.faces().to_vec());
        change(&mut vertices, &mut faces);
        TriangleMesh::new(3, vertices, faces).unwrap()
    };
    let copy = |vertices: &mut Vec<f64>, from: u32, to: u32| {
        for axis in 0..3 {
            vertices[3 * to as usize + axis] = vertices[3 * from as usize + axis];
        }
    };
    let meshes = [
        spoil(&|v, f| copy(v, f[0][0], f[0][1])), // two vertices in one place
        spoil(&|v, f| f[..9].iter().for_each(|t| (copy(v, t[0], t[1]), copy(v, t[0], t[2])).0)), // triangles in one point
        spoil(&|v, f| {
            for axis in 0..3 {
                v[3 * f[7][0] as usize + axis] = 0.5 * (v[3 * f[7][1] as usize + axis] + v[3 * f[7][2] as usize + axis]);
            }
        }), // corners on a line
        spoil(&|v, f| {
            let (a, b) = (f[3][0] as usize, f[3][1] as usize);
            for axis in 0..3 {
                v[3 * a + axis] = v[3 * b + axis] + 1e-10 * (axis as f64 - 0.7);
            }
        }), // a sliver
        spoil(&|v, _| v.iter_mut().skip(2).step_by(3).for_each(|z| *z = 0.0)), // flat
        spoil(&|v, _| v.iter_mut().enumerate().filter(|(i, _)| i % 3 > 0).for_each(|(_, x)| *x = 0.0)), // on a line
        spoil(&|_, f| f[4][1] = f[4][0]),         // a corner named twice
        spoil(&|v, _| v.iter_mut().step_by(3).for_each(|x| *x *= 1e9)), // long
        spoil(&|v, _| v.iter_mut().for_each(|x| *x *= 1e-100)),
        spoil(&|v, _| v.iter_mut().for_each(|x| *x *= 1e100)),
    ];
    for (number, mesh) in meshes.iter().enumerate() {
        for triangulation in [delaunay(mesh), cover(mesh)] {
            let (stiffness, mass) = (triangulation.stiffness(), triangulation.mass());
            let (_, unequal, sums) = figures(&stiffness);
            assert_eq!(unequal, 0, "mesh {number}");
            assert!(sums < 1e-12, "mesh {number}: {sums}");
            assert!(mass.iter().all(|mass| mass.is_finite() && *mass > 0.0), "mesh {number}");
            assert!(triangulation.gradient().values().iter().all(|x| x.is_finite()), "mesh {number}");
            assert!(triangulation.divergence(&mass).unwrap().values().iter().all(|x| x.is_finite()), "mesh {number}");
        }
    }
    assert_eq!(delaunay(&meshes[6]).left_out(), 1);
    assert!(delaunay(&meshes[2]).mollified() > 0);
}

#[test]
fn refuses_what_it_cannot_do() {
    let control = Control::default();
    let points = vec![0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0];
    let mesh = |faces: Vec<[u32; 3]>| TriangleMesh::new(3, points.clone(), faces).unwrap();
    let fin = mesh(vec![[0, 1, 2], [0, 1, 3], [0, 1, 4]]);
    assert!(matches!(intrinsic_delaunay(&fin, &control), Err(Error::Topology(text)) if text.contains("vertex 0 to vertex 1")));
    sound(&cover(&fin));
    let band = mesh(vec![[0, 1, 2], [1, 2, 3], [2, 3, 4], [3, 4, 0], [4, 0, 1]]);
    assert!(matches!(intrinsic_delaunay(&band, &control), Err(Error::Topology(text)) if text.contains("one side")));
    sound(&cover(&band));
    for empty in [mesh(vec![]), mesh(vec![[1, 1, 2]])] {
        assert!(matches!(intrinsic_delaunay(&empty, &control), Err(Error::Input(text)) if text.contains("no triangle")));
        assert!(tufted(&empty, &control).is_err());
    }
    let point = TriangleMesh::new(3, vec![1.0; 9], vec![[0, 1, 2]]).unwrap();
    assert!(matches!(tufted(&point, &control), Err(Error::Input(text)) if text.contains("no extent")));
    let huge = TriangleMesh::new(2, vec![0.0, 0.0, 1e300, 0.0, 0.0, 1e300], vec![[0, 1, 2]]).unwrap();
    assert!(matches!(tufted(&huge, &control), Err(Error::Input(text)) if text.contains("rescale")));
    control.stop();
    assert_eq!(intrinsic_delaunay(&make::sphere(4, 1.0).unwrap(), &control).err(), Some(Error::Cancelled));
}

#[test]
fn the_same_bits_on_any_number_of_threads() {
    let mesh = make::ellipsoid(40, [3.0, 1.0, 0.2]).unwrap();
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let triangulation = delaunay(&mesh);
            (triangulation.stiffness(), triangulation.mass(), triangulation.gradient())
        })
    };
    assert_eq!(run(1), run(3));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// Random triangles between random points, many of them degenerate or shared: finite, symmetric, weights of one sign.
    #[test]
    fn soups_have_a_tufted_laplacian(
        points in prop::collection::vec(-1.0f64..1.0, 30),
        faces in prop::collection::vec([0u32..10, 0u32..10, 0u32..10], 1..60),
    ) {
        let mesh = TriangleMesh::new(3, points, faces).unwrap();
        if let Ok(triangulation) = tufted(&mesh, &Control::default()) {
            let (largest, unequal, sums) = figures(&triangulation.stiffness());
            prop_assert!(!(largest > 1e-9)); // a triangle's slack may be 1e-10, its angles are then known to 1e-6
            prop_assert_eq!(unequal, 0);
            prop_assert!(!(sums > 1e-12));
            prop_assert!(triangulation.mass().iter().all(|mass| mass.is_finite() && *mass >= 0.0));
        }
    }

    /// Numbering vertices and faces otherwise, moving and scaling change nothing but rounding.
    #[test]
    fn depends_on_the_geometry_alone(shift in 1usize..200, scale in 0.01f64..100.0, angle in 0.0f64..std::f64::consts::TAU) {
        // roughened: on a symmetric shape four vertices can lie on a circle, and then either diagonal is Delaunay
        let egg = make::ellipsoid(5, [1.0, 0.37, 0.11]).unwrap();
        let rough = egg.vertices().iter().enumerate().map(|(i, x)| x * (1.0 + 1e-3 * ((i * i) % 97) as f64)).collect::<Vec<_>>();
        let mesh = TriangleMesh::new(3, rough, egg.faces().to_vec()).unwrap();
        let n = mesh.vertex_count();
        let renumber = |v: u32| ((v as usize * 89 + shift) % n) as u32; // 89 has no divisor in common with 252
        let mut vertices = vec![0.0; 3 * n];
        for v in 0..n as u32 {
            let [x, y, z] = [mesh.vertex(v)[0], mesh.vertex(v)[1], mesh.vertex(v)[2]];
            let (s, c) = angle.sin_cos();
            let to = 3 * renumber(v) as usize;
            vertices[to..to + 3].copy_from_slice(&[scale * (c * x - s * z), scale * y + 1.0, scale * (s * x + c * z)]);
        }
        let count = mesh.faces().len();
        let faces: Vec<[u32; 3]> = (0..count).map(|f| mesh.faces()[(f + shift) % count]).map(|[a, b, c]| [b, c, a].map(renumber)).collect();
        let moved = TriangleMesh::new(3, vertices, faces).unwrap();
        let f: Vec<f64> = (0..n).map(|i| ((i * 31) % 17) as f64).collect();
        let mut g = vec![0.0; n];
        (0..n as u32).for_each(|v| g[renumber(v) as usize] = f[v as usize]);
        let (one, other) = (delaunay(&mesh), delaunay(&moved));
        let (flow, moved_flow) = (one.stiffness().multiply(&f).unwrap(), other.stiffness().multiply(&g).unwrap());
        let size = flow.iter().fold(0.0, |a: f64, b| a.max(b.abs()));
        for v in 0..n as u32 {
            prop_assert!((flow[v as usize] - moved_flow[renumber(v) as usize]).abs() < 1e-9 * size);
        }
        let (mass, moved_mass) = (one.mass(), other.mass());
        for v in 0..n as u32 {
            prop_assert!((mass[v as usize] * scale * scale / moved_mass[renumber(v) as usize] - 1.0).abs() < 1e-9);
        }
    }
}
