//! Connectivity and makers: counts known in advance.

use beltrami::shape::{Topology, make};
use beltrami::{Control, Error, TriangleMesh};

fn volume(mesh: &TriangleMesh<'_>) -> f64 {
    mesh.faces()
        .iter()
        .map(|face| {
            let [a, b, c] = face.map(|corner| mesh.vertex(corner));
            a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) + a[2] * (b[0] * c[1] - b[1] * c[0])
        })
        .sum::<f64>()
        / 6.0
}

fn sharpest_angle(mesh: &TriangleMesh<'_>) -> f64 {
    let mut least = f64::INFINITY;
    for face in 0..mesh.faces().len() {
        let squares = mesh.squared_edge_lengths(face);
        let area = mesh.face_area(face);
        for k in 0..3 {
            let cosine = squares[(k + 1) % 3] + squares[(k + 2) % 3] - squares[k];
            least = least.min((4.0 * area).atan2(cosine));
        }
    }
    least.to_degrees()
}

/// Genus, boundary curves, one component, no vertex twice, oriented, no vertex without a triangle.
fn check(name: &str, mesh: &TriangleMesh<'_>, genus: usize, loops: usize) {
    let topology = Topology::new(mesh).unwrap();
    assert_eq!(topology.genus().unwrap(), genus, "{name}");
    assert_eq!(topology.boundary_loops().len(), loops, "{name}");
    assert_eq!(topology.components().1, 1, "{name}");
    assert_eq!(topology.euler_characteristic(), 2 - 2 * genus as i64 - loops as i64, "{name}");
    assert_eq!((topology.degenerate_faces(), topology.unreferenced_vertices()), (0, 0), "{name}");
    assert_eq!(topology.inconsistent_edge(), None, "{name}");
    assert_eq!(topology.non_manifold_reason(), None, "{name}");
    let mut places: Vec<Vec<u64>> =
        (0..mesh.vertex_count() as u32).map(|v| mesh.vertex(v).iter().map(|x| (x + 0.0).to_bits()).collect()).collect();
    places.sort();
    assert!(places.windows(2).all(|pair| pair[0] != pair[1]), "{name} has a vertex twice");
    if loops == 0 && mesh.dimension() == 3 {
        assert!(volume(mesh) > 0.0, "{name} is inside out");
    }
}

#[test]
fn makers_have_their_topology_at_every_resolution() {
    let control = Control::default();
    for f in [1, 2, 3, 7, 16] {
        let sphere = make::sphere(f, 2.0).unwrap();
        check("sphere", &sphere, 0, 0);
        assert!((0..sphere.vertex_count() as u32).all(|v| (sphere.vertex(v).iter().map(|x| x * x).sum::<f64>() - 4.0).abs() < 4e-15));
        check("ellipsoid", &make::ellipsoid(f, [1.0, 2.0, 0.25]).unwrap(), 0, 0);
    }
    for (rows, columns) in [(3, 3), (4, 3), (17, 9), (40, 40)] {
        check("torus", &make::torus(1.0, 0.4, rows, columns).unwrap(), 1, 0);
        check("flat torus", &make::flat_torus(1.0, 0.5, rows, columns).unwrap(), 1, 0);
        check("cylinder", &make::cylinder(0.5, 2.0, rows, columns, false).unwrap(), 0, 2);
        check("closed cylinder", &make::cylinder(0.5, 2.0, rows, columns, true).unwrap(), 0, 0);
        check("grid", &make::grid(1.0, 3.0, rows, columns).unwrap(), 0, 1);
    }
    check("one cell", &make::grid(1.0, 3.0, 2, 2).unwrap(), 0, 1);
    for rings in [1, 2, 9] {
        check("disc", &make::disc(1.5, rings).unwrap(), 0, 1);
    }
    for (p, q) in [(2, 3), (3, 2), (1, 1), (3, 5)] {
        check("knot", &make::knot(p, q, [1.0, 0.4, 0.08], 120 * (p + q), 12).unwrap(), 1, 0);
    }
    for resolution in [6, 9, 14] {
        for (radii, name) in [([1.0, 0.35], "thick"), ([10.0, 1.5], "thin"), ([0.1, 0.06], "fat")] {
            check(name, &make::figure_eight(radii, resolution, &control).unwrap(), 2, 0);
            check(name, &make::double_torus(radii, resolution, &control).unwrap(), 2, 0);
            check(name, &make::triple_torus(radii, resolution, &control).unwrap(), 3, 0);
        }
        for (arms, tube) in [(3, 0.2), (5, 0.15), (2, 0.4), (8, 0.1)] {
            check("star", &make::star(arms, 1.0, tube, resolution, &control).unwrap(), 0, 0);
        }
    }
}

#[test]
fn triangles_of_makers_are_well_shaped() {
    let control = Control::default();
    for (name, mesh, bar) in [
        ("sphere", make::sphere(32, 1.0).unwrap(), 50.0), // the icosahedron's triangles bulge to 72 degrees at its corners
        ("disc", make::disc(1.0, 20).unwrap(), 35.0),
        ("figure eight", make::figure_eight([1.0, 0.35], 10, &control).unwrap(), 20.0),
        ("star", make::star(5, 1.0, 0.15, 10, &control).unwrap(), 20.0),
    ] {
        let angle = sharpest_angle(&mesh);
        println!("{name}: {angle}");
        assert!(angle > bar, "{name}: {angle} degrees");
    }
}

#[test]
fn knows_what_it_looks_at() {
    let tetrahedron = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
    let points = |count: usize| (0..3 * count).map(|x| ((x * x * 7 + x) % 13) as f64).collect::<Vec<_>>();
    let mesh = |count: usize, faces: &[[u32; 3]]| TriangleMesh::new(3, points(count), faces.to_vec()).unwrap();
    // two tetrahedra that share a vertex: one component, a vertex with two fans
    let touching: Vec<[u32; 3]> =
        tetrahedron.iter().copied().chain(tetrahedron.iter().map(|face| face.map(|c| if c == 0 { 0 } else { c + 3 }))).collect();
    let shape = mesh(7, &touching);
    let topology = Topology::new(&shape).unwrap();
    assert_eq!(topology.non_manifold_vertices(), [0]);
    assert_eq!((topology.components().1, topology.euler_characteristic(), topology.is_closed()), (1, 3, true));
    assert!(matches!(topology.genus(), Err(Error::Topology(text)) if text.contains("vertex 0")));
    // a fin on an edge
    let fin: Vec<[u32; 3]> = tetrahedron.iter().copied().chain([[0, 1, 5]]).collect();
    let shape = mesh(6, &fin);
    let topology = Topology::new(&shape).unwrap();
    assert_eq!(topology.non_manifold_edge().map(|edge| topology.edges()[edge]), Some([0, 1]));
    assert!(matches!(topology.genus(), Err(Error::Topology(text)) if text.contains("vertex 0 to vertex 1") && text.contains("3 faces")));
    assert_eq!(topology.unreferenced_vertices(), 1);
    let curves = topology.boundary_loops();
    assert_eq!((curves.len(), curves[0].closed, curves[0].vertices.len()), (1, false, 3));
    assert_eq!(topology.non_manifold_vertices(), [] as [u32; 0]); // all joined through the shared edge
    // a Möbius band: one boundary curve, one side
    let band: Vec<[u32; 3]> = (0..5).flat_map(|i| [[i, i + 1, i + 2]]).map(|face| face.map(|c| c % 5)).collect();
    let shape = mesh(5, &band);
    let topology = Topology::new(&shape).unwrap();
    assert_eq!((topology.euler_characteristic(), topology.boundary_loops().len()), (0, 1));
    assert!(matches!(topology.oriented_faces(), Err(Error::Topology(text)) if text.contains("one side")));
    assert!(topology.genus().is_err());
    // two triangles glued along all edges: a sphere
    let shape = mesh(3, &[[0, 1, 2], [2, 1, 0]]);
    let topology = Topology::new(&shape).unwrap();
    assert_eq!((topology.genus().unwrap(), topology.is_closed(), topology.inconsistent_edge()), (0, true, None));
    // faces that name a vertex twice do not count, nor do their vertices
    let shape = mesh(7, &[[0, 1, 2], [3, 3, 4], [5, 5, 5]]);
    let topology = Topology::new(&shape).unwrap();
    assert_eq!((topology.degenerate_faces(), topology.unreferenced_vertices(), topology.euler_characteristic()), (2, 4, 1));
    assert_eq!(topology.components().0, [0, 0, 0, -1, -1, -1, -1]);
    // nothing
    let shape = mesh(0, &[]);
    let topology = Topology::new(&shape).unwrap();
    assert_eq!(
        (topology.components().1, topology.genus().unwrap(), topology.is_closed(), topology.boundary_loops().len()),
        (0, 0, false, 0)
    );
}

#[test]
fn two_curves_that_touch_stay_two() {
    // an annulus pinched at vertex 0: the hole's curve and the outer one both pass there
    let faces = vec![[0, 1, 2], [0, 3, 4]];
    let mesh = TriangleMesh::new(2, vec![0.0, 0.0, 1.0, -0.2, 1.0, 0.2, -1.0, 0.2, -1.0, -0.2], faces).unwrap();
    let topology = Topology::new(&mesh).unwrap();
    let curves: Vec<Vec<u32>> = topology.boundary_loops().into_iter().map(|curve| curve.vertices).collect();
    assert_eq!(curves, [vec![0, 1, 2], vec![0, 3, 4]]);
    assert_eq!(topology.non_manifold_vertices(), [0]);
}

#[test]
fn turns_the_fewer_faces() {
    let torus = make::torus(1.0, 0.3, 12, 9).unwrap();
    let mut faces = torus.faces().to_vec();
    for face in faces.iter_mut().step_by(3) {
        face.swap(1, 2);
    }
    let mixed = TriangleMesh::new(3, torus.vertices().to_vec(), faces).unwrap();
    let topology = Topology::new(&mixed).unwrap();
    assert!(topology.inconsistent_edge().is_some());
    assert_eq!(topology.oriented_faces().unwrap(), torus.faces());
    assert_eq!(topology.genus().unwrap(), 1);
    let loops = Topology::new(&mixed).unwrap().boundary_loops();
    assert!(loops.is_empty());
}

#[test]
fn makers_refuse_what_they_cannot_make() {
    let control = Control::default();
    for (made, word) in [
        (make::sphere(0, 1.0), "frequency is 0"),
        (make::sphere(1 << 40, 1.0), "frequency"),
        (make::sphere(100_000, 1.0), "vertices"),
        (make::sphere(3, f64::NAN), "radius is NaN"),
        (make::torus(1.0, 1.0, 9, 9), "minor_radius"),
        (make::torus(1.0, 0.5, 2, 9), "rows is 2"),
        (make::knot(2, 4, [1.0, 0.4, 0.1], 99, 9), "common divisor"),
        (make::knot(2, 3, [1.0, 0.4, 0.45], 99, 9), "tube"),
        (make::knot(7, 2, [1.0, 0.2, 0.15], 99, 9), "meet itself"),
        (make::figure_eight([1.0, 0.9], 9, &control), "holes would close"),
        (make::figure_eight([1.0, 0.3], 5, &control), "resolution is 5"),
        (make::star(3, 1.0, 0.8, 9, &control), "tube_radius"),
    ] {
        let text = made.err().map(|error| error.to_string()).unwrap_or_default();
        assert!(text.contains(word), "{text:?} says nothing of {word:?}");
    }
    control.stop();
    assert_eq!(make::star(3, 1.0, 0.2, 9, &control), Err(Error::Cancelled));
}
