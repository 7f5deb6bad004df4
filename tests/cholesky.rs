//! Sparse Cholesky: closed forms, dense matrices, hostile patterns, the same bits on any number of threads, every documented error.

use beltrami::solvers::{Cholesky, LaplacianSolver, Multilevel, Scratch, Symbolic};
use beltrami::{Control, Csr, Error};
use proptest::prelude::*;

fn csr(n: usize, mut entries: Vec<(usize, usize, f64)>) -> Csr {
    entries.sort_by_key(|&(row, column, _)| (row, column));
    let (mut starts, mut indices, mut values) = (vec![0; n + 1], Vec::new(), Vec::<f64>::new());
    let mut last = None;
    for (row, column, value) in entries {
        if last == Some((row, column)) {
            *values.last_mut().unwrap() += value;
        } else {
            indices.push(column as u32);
            values.push(value);
            starts[row + 1] = indices.len();
            last = Some((row, column));
        }
    }
    for row in 0..n {
        starts[row + 1] = starts[row + 1].max(starts[row]);
    }
    Csr::new(n, n, starts, indices, values).unwrap()
}

/// The second differences of a grid with Dirichlet ends, and the places of its nodes.
fn grid(sides: &[usize]) -> (Csr, Vec<f64>) {
    let n: usize = sides.iter().product();
    let (mut entries, mut points) = (Vec::new(), Vec::new());
    for node in 0..n {
        entries.push((node, node, 2.0 * sides.len() as f64));
        let mut stride = 1;
        for &side in sides {
            let at = node / stride % side;
            points.push(at as f64);
            if at + 1 < side {
                entries.extend([(node, node + stride, -1.0), (node + stride, node, -1.0)]);
            }
            stride *= side;
        }
    }
    (csr(n, entries), points)
}

fn noise(count: usize) -> Vec<f64> {
    let mut state = 1u64;
    let mut next = || {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 33) as f64 / (1u64 << 30) as f64 - 1.0
    };
    (0..count).map(|_| next()).collect()
}

fn residual(a: &Csr, b: &[f64], x: &[f64], width: usize) -> f64 {
    let ax = a.multiply_block(x, width).unwrap();
    let (rest, whole) = b.iter().zip(&ax).fold((0.0, 0.0), |(rest, whole), (b, ax)| (rest + (b - ax) * (b - ax), whole + b * b));
    if whole == 0.0 { rest } else { f64::sqrt(rest / whole) }
}

fn checked(a: &Csr, coordinates: Option<(&[f64], usize)>) -> Cholesky {
    let factor = Cholesky::new(a, coordinates, &Control::default()).unwrap();
    for width in [1, 2, 5, 9, 70] {
        let b = noise(a.rows() * width);
        let x = factor.solve_block(&b, width).unwrap();
        let found = residual(a, &b, &x, width);
        assert!(found <= 1e-12, "{} unknowns, {width} right-hand sides: {found:e}", a.rows());
    }
    factor
}

#[test]
fn determinant_of_grids() {
    // Eigenvalues of the grid: sums of 4 sin^2(k pi / (2 side + 2)) over its directions.
    for sides in [&[37, 23][..], &[90, 70], &[9, 8, 7], &[400], &[1], &[]] {
        let (a, points) = grid(sides);
        let mut values = vec![0.0];
        for &side in sides {
            let wave = (1..=side).map(|k| 4.0 * (k as f64 * std::f64::consts::PI / (2 * side + 2) as f64).sin().powi(2));
            values = wave.flat_map(|wave| values.iter().map(move |value| value + wave).collect::<Vec<_>>()).collect();
        }
        let exact: f64 = if sides.is_empty() { 0.0 } else { values.iter().map(|value: &f64| value.ln()).sum() };
        for coordinates in [None, (!sides.is_empty()).then_some((&points[..], sides.len()))] {
            if sides.is_empty() {
                continue;
            }
            let factor = checked(&a, coordinates);
            // n terms of size 1, each good to a few units in the last place
            assert!((factor.log_determinant() - exact).abs() <= 1e-12 * exact.abs().max(1.0), "{sides:?}");
        }
    }
}

#[test]
fn hostile_patterns() {
    let empty = Cholesky::new(&csr(0, vec![]), None, &Control::default()).unwrap();
    assert_eq!(empty.solve(&[]).unwrap(), []);
    assert_eq!((empty.nnz(), empty.log_determinant()), (0, 0.0));

    let n = 20_000;
    let diagonal = csr(n, (0..n).map(|k| (k, k, 1.0 + k as f64)).collect());
    assert_eq!(checked(&diagonal, None).nnz(), n);
    let line: Vec<f64> = (0..n).map(|k| k as f64).collect();
    checked(&diagonal, Some((&line, 1)));
    checked(&diagonal, Some((&vec![0.0; 2 * n], 2))); // all unknowns at one place

    let arrow = |hub: usize| {
        let rim = (0..n).filter(|&k| k != hub).flat_map(|k| [(k, k, 2.0), (k, hub, 0.5), (hub, k, 0.5)]);
        csr(n, rim.chain([(hub, hub, n as f64)]).collect())
    };
    for hub in [0, 777, n - 1] {
        let a = arrow(hub);
        assert!(checked(&a, None).nnz() < 2 * n + 200); // an arrow fills nothing but what a joined supernode pads
        checked(&a, Some((&line, 1)));
    }

    let n = 300;
    let dense = csr(n, (0..n * n).map(|k| (k / n, k % n, if k / n == k % n { n as f64 } else { 0.5 })).collect());
    assert_eq!(checked(&dense, None).nnz(), n * (n + 1) / 2);
    checked(&dense, Some((&noise(5 * n), 5)));

    let pieces = 3000; // many small components and one large
    let (large, _) = grid(&[60, 60]);
    let mut entries: Vec<_> = (0..3600)
        .flat_map(|row| large.row(row).0.iter().zip(large.row(row).1).map(move |(&c, &v)| (row, c as usize, v)).collect::<Vec<_>>())
        .collect();
    for k in 0..pieces {
        let at = 3600 + 2 * k;
        entries.extend([(at, at, 2.0), (at, at + 1, -1.0), (at + 1, at, -1.0), (at + 1, at + 1, 2.0)]);
    }
    checked(&csr(3600 + 2 * pieces, entries), None);

    let n = 5000;
    let cycle = csr(n, (0..n).flat_map(|k| [(k, k, 2.5), (k, (k + 1) % n, -1.0), ((k + 1) % n, k, -1.0)]).collect());
    assert!(checked(&cycle, None).nnz() < 8 * n);
}

#[test]
fn graded_and_nearly_singular() {
    // Scales over 20 orders of magnitude: D A D has the solution D^-1 A^-1 D^-1 b.
    let (a, points) = grid(&[50, 50]);
    let scale = |k: usize| 10f64.powi(k as i32 % 21 - 10);
    let entries = (0..2500).flat_map(|row| {
        a.row(row).0.iter().zip(a.row(row).1).map(move |(&c, &v)| (row, c as usize, v * scale(row) * scale(c as usize))).collect::<Vec<_>>()
    });
    let graded = csr(2500, entries.collect());
    let factor = Cholesky::new(&graded, Some((&points, 2)), &Control::default()).unwrap();
    let wanted: Vec<f64> = noise(2500).iter().enumerate().map(|(k, x)| x / scale(k)).collect();
    let b = graded.multiply(&wanted).unwrap();
    let x = factor.solve(&b).unwrap();
    for (k, (x, wanted)) in x.iter().zip(&wanted).enumerate() {
        // the condition of the unscaled grid (1e3) times rounding
        assert!((x - wanted).abs() * scale(k) < 1e-11, "unknown {k}");
    }
    assert!(residual(&graded, &b, &x, 1) <= 1e-12);

    // A Laplacian that a shift of 1e-9 keeps from being singular.
    let n = 4000;
    let chain = csr(n, (0..n).flat_map(|k| [(k, k, 2.0 + 1e-9), (k, (k + 1) % n, -1.0), ((k + 1) % n, k, -1.0)]).collect());
    let mut b = noise(n);
    let mean = b.iter().sum::<f64>() / n as f64;
    b.iter_mut().for_each(|b| *b -= mean);
    let factor = Cholesky::new(&chain, None, &Control::default()).unwrap();
    let x = factor.solve(&b).unwrap();
    let size = x.iter().map(|x| x * x).sum::<f64>().sqrt() / b.iter().map(|b| b * b).sum::<f64>().sqrt();
    // no x in double precision does better than eps |A| |x|
    assert!(residual(&chain, &b, &x, 1) <= f64::max(1e-12, 4.0 * f64::EPSILON * size));
}

#[test]
fn same_bits_on_any_number_of_threads() {
    let (a, points) = grid(&[130, 120]);
    let (cube, _) = grid(&[17, 16, 18]);
    let run = |threads: usize| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
            let mut all = Vec::new();
            for (a, coordinates) in [(&a, Some((&points[..], 2))), (&a, None), (&cube, None)] {
                let mut factor = Cholesky::new(a, coordinates, &Control::default()).unwrap();
                for width in [1, 3, 33] {
                    all.extend(factor.solve_block(&noise(a.rows() * width), width).unwrap());
                }
                factor.refactor(a, &Control::default()).unwrap();
                all.extend(factor.solve(&noise(a.rows())).unwrap());
                all.push(factor.log_determinant());
            }
            all.into_iter().map(f64::to_bits).collect::<Vec<_>>()
        })
    };
    let one = run(1);
    for threads in [2, 4] {
        assert!(run(threads) == one, "{threads} threads");
    }
}

#[test]
fn one_analysis_for_many() {
    let (a, points) = grid(&[40, 41]);
    let shifted = |shift: f64| {
        let values = (0..a.rows()).flat_map(|row| {
            a.row(row).0.iter().zip(a.row(row).1).map(move |(&c, &v)| if c as usize == row { v + shift } else { v }).collect::<Vec<_>>()
        });
        Csr::new(a.rows(), a.rows(), a.starts().to_vec(), a.indices().to_vec(), values.collect()).unwrap()
    };
    let control = Control::default();
    let symbolic = Symbolic::new(&a, Some((&points, 2)), &control).unwrap();
    let b = noise(a.rows());
    let mut kept = Cholesky::with_symbolic(&symbolic, &a, &control).unwrap();
    for shift in [0.0, 0.5, 30.0] {
        let matrix = shifted(shift);
        let x = Cholesky::with_symbolic(&symbolic, &matrix, &control).unwrap().solve(&b).unwrap();
        assert!(residual(&matrix, &b, &x, 1) < 1e-13);
        kept.refactor(&matrix, &control).unwrap();
        assert_eq!(kept.solve(&b).unwrap(), x);
        assert_eq!(kept.matrix(), matrix);
        let again = Symbolic::with_order(&matrix, symbolic.given_order(), &control).unwrap();
        assert_eq!(Cholesky::with_symbolic(&again, &matrix, &control).unwrap().solve(&b).unwrap(), x);
        let (mut out, mut scratch) = (vec![0.0; b.len()], Scratch::default());
        for _ in 0..2 {
            kept.solve_block_into(&b, 1, &mut out, &mut scratch).unwrap();
            assert!(residual(&matrix, &b, &out, 1) < 1e-13);
        }
    }
}

#[test]
fn refusals() {
    let control = Control::default();
    let text = |outcome: Result<Cholesky, Error>| match outcome {
        Err(Error::Input(text) | Error::Numerical(text)) => text,
        other => panic!("{other:?}"),
    };
    let (a, points) = grid(&[30, 31]);
    let n = a.rows();
    let changed = |row: usize, column: usize, value: f64| {
        let values = (0..n).flat_map(|r| {
            a.row(r)
                .0
                .iter()
                .zip(a.row(r).1)
                .map(move |(&c, &v)| if (r, c as usize) == (row, column) { value } else { v })
                .collect::<Vec<_>>()
        });
        Csr::new(n, n, a.starts().to_vec(), a.indices().to_vec(), values.collect()).unwrap()
    };
    // The pivot of a row with a negative diagonal entry is negative whatever the order, and no pivot before it need be.
    for row in [0, 444, n - 1] {
        let found = Cholesky::new(&changed(row, row, -1.0), Some((&points, 2)), &control);
        assert!(matches!(found, Err(Error::Numerical(_))));
        assert!(text(found).contains(&format!("pivot of row {row} is -")), "row {row}");
    }
    let lone = csr(3, vec![(0, 0, 1.0), (1, 1, 0.0), (2, 2, 1.0)]);
    assert!(text(Cholesky::new(&lone, None, &control)).contains("pivot of row 1 is 0"));
    let hole = csr(3, vec![(0, 0, 1.0), (2, 2, 1.0)]);
    assert!(text(Cholesky::new(&hole, None, &control)).contains("row 1"));

    assert!(text(Cholesky::new(&changed(3, 4, -0.9), None, &control)).contains("entry (3, 4) is -9e-1, entry (4, 3) is -1e0"));
    Cholesky::new(&changed(3, 4, -1.0 - 1e-15), None, &control).unwrap();
    let one_sided = csr(2, vec![(0, 0, 1.0), (0, 1, 0.5), (1, 1, 1.0)]);
    assert!(text(Cholesky::new(&one_sided, None, &control)).contains("none at (1, 0)"));
    let wide = Csr::new(1, 2, vec![0, 1], vec![0], vec![1.0]).unwrap();
    assert!(text(Cholesky::new(&wide, None, &control)).contains("square"));
    assert!(text(Cholesky::new(&a, Some((&points[1..], 2)), &control)).contains("coordinates"));
    let mut places = points.clone();
    places[5] = f64::NAN;
    assert!(text(Cholesky::new(&a, Some((&places, 2)), &control)).contains("coordinate 1 of unknown 2"));

    let mut factor = Cholesky::new(&a, None, &control).unwrap();
    assert!(matches!(factor.refactor(&grid(&[31, 30]).0, &control), Err(Error::Input(_))));
    factor.solve(&noise(n)).unwrap();
    assert!(matches!(factor.solve(&noise(n + 1)), Err(Error::Input(_))));
    let mut bad = noise(n);
    bad[7] = f64::INFINITY;
    assert!(matches!(factor.solve(&bad), Err(Error::Input(text)) if text.contains("row 7")));
    assert!(matches!(factor.refactor(&changed(9, 9, -1.0), &control), Err(Error::Numerical(_))));
    assert!(matches!(factor.solve(&noise(n)), Err(Error::Numerical(text)) if text.contains("refactor")));
    factor.refactor(&a, &control).unwrap();
    factor.solve(&noise(n)).unwrap();

    let stopped = Control::default();
    stopped.stop();
    assert!(matches!(Cholesky::new(&a, None, &stopped), Err(Error::Cancelled)));
    assert!(matches!(factor.refactor(&a, &stopped), Err(Error::Cancelled)));
}

#[test]
fn singular_laplacians() {
    // Two rings and an unknown of its own.
    let (n, m) = (300, 200);
    let ring = |first: usize, n: usize| {
        (0..n).flat_map(move |k| {
            [(first + k, first + k, 2.0), (first + k, first + (k + 1) % n, -1.0), (first + (k + 1) % n, first + k, -1.0)]
        })
    };
    let l = csr(n + m + 1, ring(0, n).chain(ring(n, m)).collect());
    let mass: Vec<f64> = noise(n + m + 1).iter().map(|x| x + 1.5).collect();
    let solver = LaplacianSolver::new(&l, &mass, None, &Control::default()).unwrap();
    assert_eq!(solver.components(), 3);
    let parts = [0..n, n..n + m, n + m..n + m + 1];
    let raw = noise(2 * (n + m + 1));
    let x = solver.solve(&raw, 2, &Control::default()).unwrap();
    let lx = l.multiply_block(&x, 2).unwrap();
    for k in 0..2 {
        for part in parts.clone() {
            let total: f64 = mass[part.clone()].iter().sum();
            let excess: f64 = part.clone().map(|row| raw[2 * row + k]).sum::<f64>() / total;
            let mean: f64 = part.clone().map(|row| mass[row] * x[2 * row + k]).sum::<f64>() / total;
            // solutions reach n^1.5: rounding times that
            assert!(mean.abs() < 1e-11, "mean {mean:e}");
            for row in part {
                assert!((lx[2 * row + k] - raw[2 * row + k] + excess * mass[row]).abs() < 1e-11, "row {row}");
            }
        }
    }
    assert!(matches!(solver.solve_compatible(&raw, 2, 1e-9, &Control::default()), Err(Error::Input(text)) if text.contains("component 0")));
    assert!(solver.solve_compatible(&lx, 2, 1e-9, &Control::default()).is_ok());
    assert!(
        matches!(LaplacianSolver::new(&grid(&[4, 4]).0, &[1.0; 16], None, &Control::default()), Err(Error::Input(text)) if text.contains("row 0"))
    );
    assert!(matches!(LaplacianSolver::new(&l, &vec![-1.0; n + m + 1], None, &Control::default()), Err(Error::Input(_))));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]
    #[test]
    fn random_patterns_against_dense(
        n in 1usize..140,
        edges in prop::collection::vec((0usize..140, 0usize..140, -1.0f64..1.0), 0..500),
        dimension in 0usize..6,
    ) {
        let mut entries: Vec<(usize, usize, f64)> = (0..n).map(|k| (k, k, 0.5)).collect();
        for (p, q, value) in edges {
            let (p, q) = (p % n, q % n);
            if p != q {
                entries.extend([(p, q, value), (q, p, value), (p, p, value.abs()), (q, q, value.abs())]);
            }
        }
        let a = csr(n, entries);
        let places = noise(n * dimension);
        let factor = Cholesky::new(&a, (dimension > 0).then_some((&places[..], dimension)), &Control::default()).unwrap();
        // Dense Cholesky by the textbook.
        let mut dense = vec![0.0; n * n];
        (0..n).for_each(|row| a.row(row).0.iter().zip(a.row(row).1).for_each(|(&c, &v)| dense[row * n + c as usize] = v));
        let mut log = 0.0;
        for k in 0..n {
            for j in 0..k {
                (k..n).for_each(|i| dense[i * n + k] -= dense[i * n + j] * dense[k * n + j]);
            }
            let root = dense[k * n + k].sqrt();
            log += 2.0 * root.ln();
            (k..n).for_each(|i| dense[i * n + k] /= root);
        }
        prop_assert!((factor.log_determinant() - log).abs() <= 1e-11 * (n as f64));
        let wanted = noise(n);
        let x = factor.solve(&a.multiply(&wanted).unwrap()).unwrap();
        for (x, wanted) in x.iter().zip(&wanted) {
            prop_assert!((x - wanted).abs() < 1e-9); // condition at most about 2e3
        }
    }
}

#[test]
fn multilevel_iterations_give_what_the_factor_gives() {
    let sides = [320, 250];
    let (mut a, coordinates) = grid(&sides);
    let n = a.rows();
    a = a.combine(1.0, &Csr::from_diagonal(&vec![1e-3; n]), 1.0).unwrap();
    let b: Vec<f64> = (0..n).map(|row| ((row * 7919) % 1013) as f64 - 500.0).collect();
    let exact = Cholesky::new(&a, Some((&coordinates, 2)), &Control::default()).unwrap().solve(&b).unwrap();
    let solver = Multilevel::new(a, &Control::default()).unwrap();
    let (x, residual) = solver.solve(&b, 1e-12, &Control::default()).unwrap();
    assert!(residual <= 1e-12, "{residual:e}");
    let largest = exact.iter().fold(0.0, |largest: f64, x| largest.max(x.abs()));
    let error = x.iter().zip(&exact).fold(0.0, |error: f64, (x, exact)| error.max((x - exact).abs()));
    assert!(error < 1e-9 * largest, "{error:e} of {largest:e}");
    let (scaled, _) = solver.solve(&b.iter().map(|b| 1e200 * b).collect::<Vec<_>>(), 1e-12, &Control::default()).unwrap();
    assert!(scaled.iter().zip(&x).all(|(scaled, x)| (scaled / 1e200 - x).abs() <= 1e-9 * largest));
    assert!(matches!(solver.solve(&b[1..], 1e-12, &Control::default()), Err(Error::Input(_))));
    let stopped = Control::default();
    stopped.stop();
    assert_eq!(solver.solve(&b, 1e-12, &stopped), Err(Error::Cancelled));
}
