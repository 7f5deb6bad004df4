//! Operators of point clouds: closed forms, orders of convergence, invariance, refusals.

use beltrami::near::{farthest_points, first_copies, poisson_disc};
use beltrami::operators::{LocalMesh, LocalMeshOptions, MlsOptions, VotedSimplices, local_mesh, moving_least_squares};
use beltrami::{Control, Error};

/// n points of the unit sphere along a spiral of equal areas, moved by a share of their spacing.
fn sphere(n: usize, noise: f64) -> Vec<f64> {
    let mut state = 1u64;
    let mut random = || {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 33) as f64 / (1u64 << 31) as f64 - 0.5
    };
    let h = (4.0 * std::f64::consts::PI / n as f64).sqrt();
    (0..n)
        .flat_map(|i| {
            let z = 1.0 - (2 * i + 1) as f64 / n as f64;
            let angle = i as f64 * std::f64::consts::PI * (3.0 - 5f64.sqrt());
            let r = (1.0 - z * z).sqrt();
            let p = [r * angle.cos() + noise * h * random(), r * angle.sin() + noise * h * random(), z + noise * h * random()];
            let length = (p[0] * p[0] + p[1] * p[1] + p[2] * p[2]).sqrt();
            p.map(|x| x / length)
        })
        .collect()
}

/// The points in R^5, in a frame of small rational rotations.
fn lifted(points: &[f64]) -> Vec<f64> {
    points
        .chunks(3)
        .flat_map(|p| {
            let mut q = [p[0], p[1], p[2], 0.0, 0.0];
            for (a, b, c, s) in [(0, 3, 0.6, 0.8), (1, 4, 0.28, 0.96), (2, 3, -0.8, 0.6), (0, 1, 0.96, -0.28), (4, 2, 0.6, -0.8)] {
                (q[a], q[b]) = (c * q[a] - s * q[b], s * q[a] + c * q[b]);
            }
            [q[0] + 3.0, q[1] - 1.0, q[2], q[3], q[4]]
        })
        .collect()
}

fn mesh(points: &[f64], ambient: usize, dimension: usize) -> LocalMesh {
    local_mesh(points, ambient, dimension, &LocalMeshOptions::default(), &Control::default()).unwrap()
}

fn view<'a>(points: &'a [f64], ambient: usize, mesh: &'a LocalMesh) -> VotedSimplices<'a> {
    VotedSimplices::new(points, ambient, mesh.dimension, &mesh.simplices, &mesh.votes).unwrap().stretched(&mesh.stretch).unwrap()
}

#[test]
fn a_grid_has_all_votes_and_the_finite_difference_rows() {
    // Ties everywhere: each square's diagonal is the same for all four corners, whatever it is, and counts nothing.
    let (rows, columns) = (7, 9);
    let points: Vec<f64> = (0..rows * columns).flat_map(|i| [(i % columns) as f64, (i / columns) as f64]).collect();
    let mesh = mesh(&points, 2, 2);
    assert!(mesh.votes.iter().all(|&votes| votes == 3));
    assert_eq!(mesh.votes.len(), 2 * (rows - 1) * (columns - 1));
    assert_eq!(mesh.boundary.iter().filter(|&&open| open).count(), 2 * (rows + columns) - 4);
    let stiffness = view(&points, 2, &mesh).stiffness().unwrap();
    let inner = 3 * columns + 4;
    for (&column, &value) in stiffness.row(inner).0.iter().zip(stiffness.row(inner).1) {
        let expected = match (column as usize).abs_diff(inner) {
            0 => 4.0,
            distance if distance == 1 || distance == columns => -1.0,
            _ => 0.0,
        };
        assert!((value - expected).abs() < 1e-12, "{column}: {value}");
    }
}

#[test]
fn a_grid_of_three_dimensions_fills_its_box() {
    let points: Vec<f64> = (0..216).flat_map(|i| [(i % 6) as f64, (i / 6 % 6) as f64, (i / 36) as f64]).collect();
    let mesh = mesh(&points, 3, 3);
    let mass = view(&points, 3, &mesh).mass().unwrap();
    assert!((mass.iter().sum::<f64>() - 125.0).abs() < 1e-9, "{}", mass.iter().sum::<f64>());
    // linear functions have constant gradients on every tetrahedron
    let f: Vec<f64> = points.chunks(3).map(|p| p[0] - 2.0 * p[1] + 3.0 * p[2]).collect();
    let gradient = view(&points, 3, &mesh).gradient().unwrap().multiply(&f).unwrap();
    for g in gradient.chunks(3) {
        assert!((g[0] - 1.0).abs() < 1e-9 && (g[1] + 2.0).abs() < 1e-9 && (g[2] - 3.0).abs() < 1e-9);
    }
}

#[test]
fn stiffness_is_symmetric_and_harmonics_have_their_energies() {
    let points = sphere(4000, 0.5);
    let mesh = mesh(&points, 3, 2);
    assert!(mesh.certified.iter().all(|&certified| certified));
    assert!(mesh.boundary.iter().all(|&open| !open));
    assert!((mesh.estimated_dimension - 2.0).abs() < 0.3);
    let simplices = view(&points, 3, &mesh);
    let (stiffness, mass) = (simplices.stiffness().unwrap(), simplices.mass().unwrap());
    assert_eq!(stiffness, stiffness.transpose());
    assert!(mass.iter().all(|&m| m > 0.0));
    // An inscribed polyhedron: area short by about h²/8 of 4 pi.
    assert!((mass.iter().sum::<f64>() / (4.0 * std::f64::consts::PI) - 1.0).abs() < 1e-3);
    // ∫|grad x|² = 8 pi / 3, ∫|grad xy|² = 6 ∫ x²y² = 8 pi / 5; the inscribed polyhedron is h² (1.5e-3) off
    for (f, energy) in
        [(points.chunks(3).map(|p| p[0]).collect::<Vec<_>>(), 8.0 / 3.0), (points.chunks(3).map(|p| p[0] * p[1]).collect(), 1.6)]
    {
        let product: f64 = stiffness.multiply(&f).unwrap().iter().zip(&f).map(|(x, y)| x * y).sum();
        assert!((product / (energy * std::f64::consts::PI) - 1.0).abs() < 5e-3, "{product}");
    }
}

#[test]
fn weights_by_a_potential_are_those_of_an_edge() {
    // One square cut in two: S(w) on f = x is w on the edges along x. U = x: harmonic mean of e^0 and e^-1 along the edge = 1 / (e - 1).
    let points = [0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 1.0];
    let square = VotedSimplices::new(&points, 2, 2, &[0, 1, 2, 1, 2, 3], &[3, 3]).unwrap();
    let s = square.weighted_stiffness(&[0.0, 1.0, 0.0, 1.0]).unwrap();
    let energy: f64 = s.multiply(&[0.0, 1.0, 0.0, 1.0]).unwrap().iter().zip([0.0, 1.0, 0.0, 1.0]).map(|(x, y)| x * y).sum();
    assert!((energy - 1.0 / (1f64.exp() - 1.0)).abs() < 1e-15);
    // A potential of thousands neither overflows nor gives NaN; shifting it changes nothing.
    let steep = square.weighted_stiffness(&[5e3, 0.0, 1e4, 5.0]).unwrap();
    assert!(steep.values().iter().all(|value| value.is_finite()));
    assert_eq!(steep, square.weighted_stiffness(&[6e3, 1e3, 1.1e4, 1005.0]).unwrap());
    assert_eq!(square.stiffness().unwrap(), square.weighted_stiffness(&[7.0; 4]).unwrap());
}

#[test]
fn the_same_cloud_in_more_dimensions_has_the_same_operators() {
    let points = sphere(1500, 0.6);
    let moved = lifted(&points);
    let (a, b) = (mesh(&points, 3, 2), mesh(&moved, 5, 2));
    assert_eq!((&a.simplices, &a.votes), (&b.simplices, &b.votes));
    let (a, b) = (view(&points, 3, &a).stiffness().unwrap(), view(&moved, 5, &b).stiffness().unwrap());
    let most = a.values().iter().fold(0.0, |most: f64, x| most.max(x.abs()));
    assert!(a.values().iter().zip(b.values()).all(|(x, y)| (x - y).abs() < 1e-11 * most)); // rounding, amplified by thin triangles
    let options = MlsOptions { degree: 3, ..Default::default() };
    let x = moving_least_squares(&points, 3, 2, &options, &Control::default()).unwrap().laplacian;
    let y = moving_least_squares(&moved, 5, 2, &options, &Control::default()).unwrap().laplacian;
    let most = x.values().iter().fold(0.0, |most: f64, x| most.max(x.abs()));
    assert!(x.values().iter().zip(y.values()).all(|(x, y)| (x - y).abs() < 1e-9 * most)); // rounding times the fits' condition
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    let points = sphere(3000, 0.7);
    let run = |threads: usize| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
            let mesh = mesh(&points, 3, 2);
            let simplices = view(&points, 3, &mesh);
            let mls = moving_least_squares(&points, 3, 2, &MlsOptions::default(), &Control::default()).unwrap();
            let parts = (simplices.stiffness().unwrap(), simplices.mass().unwrap(), simplices.mean_edge_length());
            (mesh, parts, mls)
        })
    };
    assert_eq!(run(1), run(3));
}

#[test]
fn least_squares_converge_at_their_orders() {
    // f = x y + z³, harmonics of degrees 2, 3, 1: Δf = -6 x y - 12 (z³ - 0.6 z) - 1.2 z
    for degree in [2, 3, 4] {
        let mut rows = vec![];
        for n in [700, 1400, 2800, 5600] {
            let points = sphere(n, 0.5);
            let f: Vec<f64> = points.chunks(3).map(|p| p[0] * p[1] + p[2].powi(3)).collect();
            let mls = moving_least_squares(&points, 3, 2, &MlsOptions { degree, ..Default::default() }, &Control::default()).unwrap();
            let laplacian = mls.laplacian.multiply(&f).unwrap();
            let gradient = mls.gradient.multiply(&f).unwrap();
            let (mut of_laplacian, mut of_gradient) = (0.0f64, 0.0f64);
            for (i, p) in points.chunks(3).enumerate() {
                let exact = -6.0 * p[0] * p[1] - 12.0 * (p[2].powi(3) - 0.6 * p[2]) - 1.2 * p[2];
                of_laplacian += (laplacian[i] - exact).powi(2);
                let ambient = [p[1], p[0], 3.0 * p[2] * p[2]];
                let along: f64 = ambient.iter().zip(p).map(|(g, x)| g * x).sum();
                of_gradient += (0..3).map(|a| (gradient[3 * i + a] - ambient[a] + along * p[a]).powi(2)).sum::<f64>();
            }
            rows.push([-(n as f64).ln() / 2.0, (of_gradient / n as f64).ln() / 2.0, (of_laplacian / n as f64).ln() / 2.0]);
        }
        let slope = |column: usize| {
            let mean = |c: usize| rows.iter().map(|row| row[c]).sum::<f64>() / rows.len() as f64;
            let (x, y) = (mean(0), mean(column));
            let top: f64 = rows.iter().map(|row| (row[0] - x) * (row[column] - y)).sum();
            top / rows.iter().map(|row| (row[0] - x).powi(2)).sum::<f64>()
        };
        // degree for the gradient, degree - 1 for the Laplacian; four random clouds fit a slope to about 0.3
        assert!(slope(1) > degree as f64 - 0.4, "gradient of degree {degree}: {}", slope(1));
        assert!(slope(2) > degree as f64 - 1.4, "Laplacian of degree {degree}: {}", slope(2));
    }
}

#[test]
fn constrained_rows_have_no_negative_entry_beside_the_diagonal() {
    let points = sphere(1200, 0.5);
    let free = MlsOptions { degree: 3, constrained: false, ..Default::default() };
    let constrained = MlsOptions { degree: 3, ..Default::default() };
    let solve = |options: &MlsOptions| moving_least_squares(&points, 3, 2, options, &Control::default()).unwrap();
    assert!(!solve(&free).signed.is_empty());
    let mls = solve(&constrained);
    assert!(mls.signed.is_empty());
    for row in 0..1200 {
        let (columns, values) = mls.laplacian.row(row);
        assert!(columns.iter().zip(values).all(|(&column, &value)| column as usize == row || value >= 0.0));
        assert!(values.iter().sum::<f64>().abs() < 1e-9 * values.iter().map(|x| x.abs()).sum::<f64>());
    }
}

#[test]
fn curves_and_three_spheres() {
    let n = 200;
    let circle: Vec<f64> =
        (0..n).flat_map(|i| [(i as f64 * 0.01 * std::f64::consts::PI).cos(), (i as f64 * 0.01 * std::f64::consts::PI).sin()]).collect();
    let curve = mesh(&circle, 2, 1);
    assert_eq!(curve.votes, vec![2; n]);
    let length: f64 = view(&circle, 2, &curve).mass().unwrap().iter().sum();
    assert!((length - 2.0 * n as f64 * (0.005 * std::f64::consts::PI).sin()).abs() < 1e-12);

    // S^3 as pairs (cos s e^{ia}, sin s e^{ib}), uniform in sin² s, a and b: a lattice of irrational steps
    let points: Vec<f64> = (0..3000)
        .flat_map(|i| {
            let u = (i as f64 + 0.5) / 3000.0;
            let (a, b) =
                (i as f64 * 0.819_172_513_396_164_4 * std::f64::consts::TAU, i as f64 * 0.671_043_606_703_789_2 * std::f64::consts::TAU);
            let (c, s) = ((1.0 - u).sqrt(), u.sqrt());
            [c * a.cos(), c * a.sin(), s * b.cos(), s * b.sin()]
        })
        .collect();
    let cloud = mesh(&points, 4, 3);
    let volume: f64 = view(&points, 4, &cloud).mass().unwrap().iter().sum();
    // flat tetrahedra are short by 2 %; curved to second order, an error of order h^4 and of the few simplices that stars disagree on is left
    assert!((volume / (2.0 * std::f64::consts::PI.powi(2)) - 1.0).abs() < 0.01, "{volume}");
}

/// 23 x 23 grid points without the 11 x 11 in the middle: a hole, unless points are expected to be so far apart.
#[test]
fn reach_says_what_is_a_hole() {
    let points: Vec<f64> = (0..529)
        .map(|i| (i % 23, i / 23))
        .filter(|(x, y)| !((6..17).contains(x) && (6..17).contains(y)))
        .flat_map(|(x, y)| [f64::from(x), f64::from(y)])
        .collect();
    let area = |reach: Option<&[f64]>| -> f64 {
        let options = LocalMeshOptions { reach, ..Default::default() };
        let mesh = local_mesh(&points, 2, 2, &options, &Control::default()).unwrap();
        view(&points, 2, &mesh).volumes().iter().zip(&mesh.votes).map(|(area, &votes)| area * f64::from(votes) / 3.0).sum()
    };
    let (plain, wide) = (area(None), area(Some(&[4.0; 408])));
    assert!(plain < 400.0 && (wide - 484.0).abs() < 1e-9, "{plain} {wide}"); // corners of the hole are rounded off
    for wrong in [vec![1.0; 3], vec![-1.0; 408], vec![f64::NAN; 408]] {
        let options = LocalMeshOptions { reach: Some(&wrong), ..Default::default() };
        let refused = local_mesh(&points, 2, 2, &options, &Control::default()).unwrap_err();
        assert!(refused.to_string().contains("reach"), "{refused}");
    }
}

#[test]
fn what_is_wrong_is_named() {
    let message = |points: &[f64], ambient: usize, dimension: usize| match local_mesh(
        points,
        ambient,
        dimension,
        &LocalMeshOptions::default(),
        &Control::default(),
    ) {
        Err(Error::Input(text)) => text,
        other => panic!("{other:?}"),
    };
    let mut points = sphere(400, 0.3);
    let copy: Vec<f64> = points[51..54].to_vec();
    points.extend(copy);
    let text = message(&points, 3, 2);
    assert!(text.contains("point 17 coincides with point 400") && text.contains("deduplicate"), "{text}");
    points.truncate(1200);
    points.splice(30..30, [50.0, 0.0, 0.0]);
    let text = message(&points, 3, 2);
    assert!(text.contains("point 10 is isolated"), "{text}");
    points[200] = f64::NAN;
    assert!(message(&points, 3, 2).contains("coordinate 2 of point 66 is NaN"));
    let line: Vec<f64> = (0..100).flat_map(|i| [i as f64, 2.0 * i as f64, 0.0]).collect();
    assert!(message(&line, 3, 2).contains("100 of 100 points") && message(&line, 3, 2).contains("on a line"));
    assert!(message(&[0.0; 9], 3, 2).contains("3 points"));
    assert!(message(&[0.5; 30], 3, 2).contains("at one place"));
    assert!(message(&sphere(50, 0.0), 3, 4).contains("from 1 to 3") || message(&sphere(50, 0.0), 3, 4).contains("not 4"));
    let columns: Vec<f64> = (0..80).flat_map(|i| [(i % 2) as f64, (i / 2) as f64]).collect();
    let options = MlsOptions { degree: 4, ..Default::default() };
    let refused = moving_least_squares(&columns, 2, 2, &options, &Control::default()).unwrap_err().to_string();
    assert!(refused.contains("degree 4") && refused.contains("lower degree="), "{refused}");
    let control = Control::default();
    control.stop();
    assert_eq!(local_mesh(&sphere(400, 0.0), 3, 2, &LocalMeshOptions::default(), &control), Err(Error::Cancelled));
}

#[test]
fn extreme_units_give_the_same_shape() {
    let points = sphere(600, 0.4);
    let base = mesh(&points, 3, 2);
    for unit in [1e-140, 1e-20, 1e30, 1e150] {
        let scaled: Vec<f64> = points.iter().map(|x| x * unit).collect();
        let other = mesh(&scaled, 3, 2);
        assert_eq!(base.simplices, other.simplices, "{unit}");
        let (x, y) = (view(&points, 3, &base).stiffness().unwrap(), view(&scaled, 3, &other).stiffness().unwrap());
        assert!(x.values().iter().zip(y.values()).all(|(x, y)| (x - y).abs() < 1e-12));
    }
    let huge: Vec<f64> = points.iter().map(|x| x * 1e200).collect();
    let other = mesh(&huge, 3, 2);
    assert!(view(&huge, 3, &other).mass().unwrap_err().to_string().contains("overflow"));
}

#[test]
fn subsets_keep_their_distance() {
    let points = sphere(2000, 0.9);
    let distance = |a: u32, b: u32| (0..3).map(|i| (points[3 * a as usize + i] - points[3 * b as usize + i]).powi(2)).sum::<f64>().sqrt();
    let order: Vec<u32> = (0..2000).rev().collect();
    let chosen = poisson_disc(&points, 3, 0.3, &order, &Control::default()).unwrap();
    assert_eq!(chosen[0], 1999);
    for (at, &a) in chosen.iter().enumerate() {
        assert!(chosen[..at].iter().all(|&b| distance(a, b) >= 0.3 - 1e-9));
    }
    assert!((0..2000).all(|a| chosen.iter().any(|&b| distance(a, b) < 0.3)));
    let far = farthest_points(&points, 3, 20, 5, &Control::default()).unwrap();
    for at in 1..20 {
        let cover = |x: u32| far[..at].iter().map(|&y| distance(x, y)).fold(f64::INFINITY, f64::min);
        let most = (0..2000).map(cover).fold(0.0, f64::max);
        assert!((cover(far[at]) - most).abs() < 1e-12);
    }
    let mut twice = points.clone();
    twice.extend_from_slice(&points[..30]);
    let kept = first_copies(&twice, 3, &Control::default()).unwrap();
    assert!(kept[..2000].iter().all(|&kept| kept) && kept[2000..].iter().all(|&kept| !kept));
}

#[test]
fn stars_break_the_ties_of_grids_alike() {
    // cells of a torus' grid are trapezoids: all corners lie on a circle
    let (rows, columns) = (80, 32);
    let torus: Vec<f64> = (0..rows * columns)
        .flat_map(|i| {
            let (u, v) =
                ((i / columns) as f64 / rows as f64 * std::f64::consts::TAU, (i % columns) as f64 / columns as f64 * std::f64::consts::TAU);
            let w = 1.0 + 0.4 * v.cos();
            [w * u.cos(), w * u.sin(), 0.4 * v.sin()]
        })
        .collect();
    let surface = mesh(&torus, 3, 2);
    assert!(!surface.boundary.contains(&true));
    let area: f64 = view(&torus, 3, &surface).mass().unwrap().iter().sum();
    assert!((area / (1.6 * std::f64::consts::PI.powi(2)) - 1.0).abs() < 0.01, "{area}");
}
