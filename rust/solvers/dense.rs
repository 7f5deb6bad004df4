//! Dense work on one front: its columns' Cholesky factor and the update of what lies below. Everything is column-major.
//!
//! Large blocks go to faer; small ones to plain loops that are compiled for the machine's vector instructions too.
//! Blocks are cut the same way whatever the number of threads.

use crate::control::Control;
use crate::error::Error;
use faer::linalg::matmul::{self, triangular};
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Accum, MatMut, MatRef, Par};

const NARROW: usize = 8; // columns that plain loops factor
const SMALL: usize = 48; // rows of an update that plain loops make
const BLOCK: usize = 128; // columns of a block of a large front
const TILE: usize = 256; // rows and columns of a parallel tile

/// Why a front could not be factored.
pub(crate) enum Refused {
    /// This column's pivot had this value.
    Pivot(usize, f64),
    /// The work was stopped.
    Stopped(Error),
}

impl From<Error> for Refused {
    fn from(error: Error) -> Self {
        Refused::Stopped(error)
    }
}

/// Runs plain loops compiled for this machine, fused multiply-add where it has that: every aarch64 does, of x86 the newer ones.
#[inline(always)]
pub(crate) fn vectorized<R>(work: impl Loops<R>) -> R {
    #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
    if let Some(simd) = pulp::x86::V3::try_new() {
        return simd.vectorize(Fused(work, std::marker::PhantomData));
    }
    work.run::<{ cfg!(target_arch = "aarch64") }>()
}

/// Loops that are compiled with and without fused multiply-add.
pub(crate) trait Loops<R> {
    /// The work.
    fn run<const FUSED: bool>(self) -> R;
}

#[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
struct Fused<R, L: Loops<R>>(L, std::marker::PhantomData<R>);

#[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
impl<R, L: Loops<R>> pulp::NullaryFnOnce for Fused<R, L> {
    type Output = R;
    #[inline(always)]
    fn call(self) -> R {
        self.0.run::<true>()
    }
}

/// `c - a * b`
#[inline(always)]
pub(crate) fn minus<const FUSED: bool>(c: f64, a: f64, b: f64) -> f64 {
    if FUSED { (-a).mul_add(b, c) } else { c - a * b }
}

/// Factors the first `columns` columns of a front of `rows` rows: `panel` holds them and becomes L. A pivot must exceed its floor.
pub(crate) fn factor(panel: &mut [f64], rows: usize, columns: usize, floors: &[f64], control: &Control) -> Result<(), Refused> {
    if rows > TILE && columns > BLOCK {
        return factor_blocks(panel, rows, columns, floors, control);
    }
    factor_part(panel, rows, 0, columns, floors)
}

/// Factors columns `from..to`, from whose rows all earlier columns have been taken away already.
fn factor_part(panel: &mut [f64], rows: usize, from: usize, to: usize, floors: &[f64]) -> Result<(), Refused> {
    if to - from <= NARROW {
        return vectorized(Narrow { panel: &mut panel[from * rows..to * rows], rows, from, floors: &floors[from..to] });
    }
    let middle = from + ((to - from) / 2).next_multiple_of(NARROW);
    factor_part(panel, rows, from, middle, floors)?;
    let (left, right) = panel.split_at_mut(middle * rows);
    let left = MatRef::from_column_major_slice(&left[from * rows..], rows, middle - from).subrows(middle, rows - middle);
    let right =
        MatMut::from_column_major_slice_mut(&mut right[..(to - middle) * rows], rows, to - middle).subrows_mut(middle, rows - middle);
    matmul::matmul(right, Accum::Add, left, left.subrows(0, to - middle).transpose(), -1.0, Par::Seq);
    factor_part(panel, rows, middle, to, floors)
}

/// A few columns by plain loops; `panel` starts at column `from`.
struct Narrow<'a> {
    panel: &'a mut [f64],
    rows: usize,
    from: usize,
    floors: &'a [f64],
}

impl Loops<Result<(), Refused>> for Narrow<'_> {
    #[inline(always)]
    fn run<const FUSED: bool>(self) -> Result<(), Refused> {
        let Narrow { panel, rows, from, floors } = self;
        for (k, &floor) in floors.iter().enumerate() {
            let (done, rest) = panel.split_at_mut((k + 1) * rows);
            let column = &mut done[k * rows + from + k..];
            let pivot = column[0];
            if !(pivot > floor && pivot < f64::INFINITY) {
                return Err(Refused::Pivot(from + k, pivot));
            }
            let root = pivot.sqrt();
            let inverse = 1.0 / root;
            column[0] = root;
            for entry in &mut column[1..] {
                *entry *= inverse;
            }
            for (j, target) in rest.chunks_exact_mut(rows).enumerate() {
                let source = &column[j + 1..];
                let factor = source[0];
                for (target, &source) in target[from + k + 1 + j..].iter_mut().zip(source) {
                    *target = minus::<FUSED>(*target, factor, source);
                }
            }
        }
        Ok(())
    }
}

/// Large fronts: blocks of columns, tiles in parallel.
fn factor_blocks(panel: &mut [f64], rows: usize, columns: usize, floors: &[f64], control: &Control) -> Result<(), Refused> {
    for from in (0..columns).step_by(BLOCK) {
        control.check()?;
        let to = (from + BLOCK).min(columns);
        let width = to - from;
        let (block, rest) = panel[from * rows..].split_at_mut(width * rows);
        // The square on the diagonal, on its own so that it stays in cache.
        let mut square = vec![0.0; width * width];
        for (square, column) in square.chunks_exact_mut(width).zip(block.chunks_exact(rows)) {
            square.copy_from_slice(&column[from..to]);
        }
        factor_part(&mut square, width, 0, width, &floors[from..to]).map_err(|refused| match refused {
            Refused::Pivot(column, value) => Refused::Pivot(from + column, value),
            stopped => stopped,
        })?;
        for (square, column) in square.chunks_exact(width).zip(block.chunks_exact_mut(rows)) {
            column[from..to].copy_from_slice(square);
        }
        if to == rows {
            break;
        }
        let square = MatRef::from_column_major_slice(&square, width, width);
        let below = MatMut::from_column_major_slice_mut(block, rows, width).subrows_mut(to, rows - to);
        divide(square, below);
        if to < columns {
            let below = MatRef::from_column_major_slice(block, rows, width).subrows(to, rows - to);
            let rest =
                MatMut::from_column_major_slice_mut(&mut rest[..(columns - to) * rows], rows, columns - to).subrows_mut(to, rows - to);
            let (upper, lower) = rest.split_at_row_mut(columns - to);
            let (near, far) = below.split_at_row(columns - to);
            rayon::join(|| subtract_lower(upper, near), || subtract(lower, far, near));
        }
    }
    Ok(())
}

/// `X := X L^-T` in tiles of rows.
fn divide(lower: MatRef<'_, f64>, x: MatMut<'_, f64>) {
    if x.nrows() > TILE {
        let middle = (x.nrows() / 2).next_multiple_of(16);
        let (upper, under) = x.split_at_row_mut(middle);
        rayon::join(|| divide(lower, upper), || divide(lower, under));
    } else {
        solve_lower_triangular_in_place(lower, x.transpose_mut(), Par::Seq);
    }
}

/// `C -= A B^T` in tiles.
fn subtract(c: MatMut<'_, f64>, a: MatRef<'_, f64>, b: MatRef<'_, f64>) {
    if c.nrows() > TILE && c.nrows() >= c.ncols() {
        let middle = (c.nrows() / 2).next_multiple_of(16);
        let ((upper, lower), (first, second)) = (c.split_at_row_mut(middle), a.split_at_row(middle));
        rayon::join(|| subtract(upper, first, b), || subtract(lower, second, b));
    } else if c.ncols() > TILE {
        let middle = (c.ncols() / 2).next_multiple_of(16);
        let ((left, right), (first, second)) = (c.split_at_col_mut(middle), b.split_at_row(middle));
        rayon::join(|| subtract(left, a, first), || subtract(right, a, second));
    } else if c.nrows() > 0 && c.ncols() > 0 {
        matmul::matmul(c, Accum::Add, a, b.transpose(), -1.0, Par::Seq);
    }
}

/// The lower triangle of `C -= A A^T` in tiles.
fn subtract_lower(c: MatMut<'_, f64>, a: MatRef<'_, f64>) {
    use triangular::BlockStructure::{Rectangular, TriangularLower};
    if c.nrows() > TILE {
        let middle = (c.nrows() / 2).next_multiple_of(16);
        let (upper, _, left, right) = c.split_at_mut(middle, middle);
        let (first, second) = a.split_at_row(middle);
        rayon::join(|| subtract(left, second, first), || rayon::join(|| subtract_lower(upper, first), || subtract_lower(right, second)));
    } else if c.nrows() > 0 {
        triangular::matmul(c, TriangularLower, Accum::Add, a, Rectangular, a.transpose(), Rectangular, -1.0, Par::Seq);
    }
}

/// Takes `L2 L2^T` from the lower triangle of `update`, L2 being the rows of the panel below its columns.
pub(crate) fn update(update: &mut [f64], panel: &[f64], rows: usize, columns: usize) {
    let below = rows - columns;
    if below == 0 || columns == 0 {
        return;
    }
    if below <= SMALL || columns <= 4 {
        return vectorized(Outer { update, panel, rows, columns });
    }
    let panel = MatRef::from_column_major_slice(panel, rows, columns).subrows(columns, below);
    subtract_lower(MatMut::from_column_major_slice_mut(update, below, below), panel);
}

struct Outer<'a> {
    update: &'a mut [f64],
    panel: &'a [f64],
    rows: usize,
    columns: usize,
}

impl Loops<()> for Outer<'_> {
    #[inline(always)]
    fn run<const FUSED: bool>(self) {
        let Outer { update, panel, rows, columns } = self;
        let below = rows - columns;
        for (j, target) in update.chunks_exact_mut(below).enumerate() {
            let target = &mut target[j..];
            let mut four = panel.chunks_exact(4 * rows);
            for group in &mut four {
                let column = |k: usize| &group[k * rows + columns + j..(k + 1) * rows];
                let (a, b, c, d) = (column(0), column(1), column(2), column(3));
                let (p, q, r, s) = (a[0], b[0], c[0], d[0]);
                for ((((target, &a), &b), &c), &d) in target.iter_mut().zip(a).zip(b).zip(c).zip(d) {
                    let sum = minus::<FUSED>(minus::<FUSED>(*target, p, a), q, b);
                    *target = minus::<FUSED>(minus::<FUSED>(sum, r, c), s, d);
                }
            }
            for column in four.remainder().chunks_exact(rows) {
                let column = &column[columns + j..];
                let factor = column[0];
                for (target, &source) in target.iter_mut().zip(column) {
                    *target = minus::<FUSED>(*target, factor, source);
                }
            }
        }
    }
}
