//! Solving with the factor: down the elimination tree and up again, for a few right-hand sides kept side by side.

#![allow(clippy::needless_range_loop)] // closures would not be compiled for the machine's vectors

use super::dense::{Loops, minus, vectorized};
use super::symbolic::{NONE, Symbolic};
use rayon::prelude::*;
use std::sync::{Mutex, PoisonError};

const CHUNK: usize = 4096;
const PANEL: usize = 32; // columns solved before the rows below hear of it

/// Vectors that solves use again. Which is used where has no influence on results.
#[derive(Debug, Default)]
pub(crate) struct Pool(Mutex<Vec<Vec<f64>>>);

impl Pool {
    fn take(&self) -> Vec<f64> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).pop().unwrap_or_default()
    }

    fn give(&self, mut vector: Vec<f64>) {
        vector.clear();
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push(vector);
    }
}

/// A factor and the matrix it belongs to, in the order of elimination.
pub(crate) struct Block<'a> {
    pub(crate) symbolic: &'a Symbolic,
    pub(crate) values: &'a [f64],
    pub(crate) entries: &'a [f64],
    pub(crate) pool: &'a Pool,
    pub(crate) refine: Option<f64>,
}

type Rows<'a, const W: usize> = &'a [[f64; W]];

impl Block<'_> {
    /// Solves for `columns` right-hand sides from `first`; the solutions are the first n rows of `space`. False if they overflow.
    pub(crate) fn solve<const W: usize>(&self, b: &[f64], width: usize, first: usize, columns: usize, space: &mut [f64]) -> bool {
        let n = self.symbolic.n;
        let (rows, _) = space.as_chunks_mut::<W>();
        let (x, rest) = rows.split_at_mut(n);
        let order = &self.symbolic.order;
        let gather = |chunk: usize, out: &mut [[f64; W]]| {
            for (out, &old) in out.iter_mut().zip(&order[chunk * CHUNK..]) {
                *out = [0.0; W];
                out[..columns].copy_from_slice(&b[old as usize * width + first..][..columns]);
            }
        };
        x.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, x)| gather(chunk, x));
        self.both_sweeps(x);
        if let Some(enough) = self.refine {
            let (right, correction) = rest.split_at_mut(n);
            right.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, right)| gather(chunk, right));
            let units = units(right);
            let scale = squares(right, &units);
            let before = self.residual(right, x, correction, &units);
            let poor = |column: usize| before[column] > enough * enough * scale[column] && before[column].is_finite();
            if (0..columns).any(poor) {
                self.both_sweeps(correction);
                x.par_chunks_mut(CHUNK).zip(correction.par_chunks(CHUNK)).for_each(|(x, correction)| {
                    for (x, correction) in x.iter_mut().zip(correction) {
                        (0..W).for_each(|k| x[k] += correction[k]);
                    }
                });
                // The step is kept unless it made things worse, as it may where the matrix is singular to working precision.
                let step: &mut [[f64; W]] = correction;
                let mut after_space = vec![[0.0; W]; n];
                let after = self.residual(right, x, &mut after_space, &units);
                let worse: Vec<usize> = (0..columns).filter(|&k| after[k] > before[k] || after[k].is_nan()).collect();
                if !worse.is_empty() {
                    for (x, step) in x.iter_mut().zip(step.iter()) {
                        worse.iter().for_each(|&k| x[k] -= step[k]);
                    }
                }
            }
        }
        x.par_chunks(CHUNK).all(|x| x.iter().flatten().all(|number| number.is_finite()))
    }

    /// `out := b - A x`, and the sum of its squares in each column, in units.
    fn residual<const W: usize>(&self, b: Rows<'_, W>, x: Rows<'_, W>, out: &mut [[f64; W]], units: &[f64; W]) -> [f64; W] {
        let symbolic = self.symbolic;
        out.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, out)| {
            for (offset, out) in out.iter_mut().enumerate() {
                let row = chunk * CHUNK + offset;
                let mut sum = b[row];
                let range = symbolic.entry_starts[row]..symbolic.entry_starts[row + 1];
                for (&column, &value) in symbolic.columns[range.clone()].iter().zip(&self.entries[range]) {
                    let x = &x[column as usize];
                    (0..W).for_each(|k| sum[k] -= value * x[k]);
                }
                *out = sum;
            }
        });
        squares(out, units)
    }

    fn both_sweeps<const W: usize>(&self, x: &mut [[f64; W]]) {
        let groups = self.symbolic.groups(self.symbolic.roots());
        self.forward(&groups, x);
        self.backward(&groups, x, &[], &[]);
    }

    fn first_row(&self, groups: &[&[u32]]) -> usize {
        self.symbolic.firsts[self.symbolic.subtree_firsts[groups[0][0] as usize] as usize] as usize
    }

    fn panel(&self, node: usize) -> &[f64] {
        &self.values[self.symbolic.value_starts[node]..self.symbolic.value_starts[node + 1]]
    }

    /// `L y = x` for groups of subtrees whose rows are `x`; returns what each group hands up.
    fn forward<const W: usize>(&self, groups: &[&[u32]], x: &mut [[f64; W]]) -> Vec<Vec<f64>> {
        match groups {
            [] => Vec::new(),
            [group] => vec![self.forward_group(group, x)],
            _ => {
                let (one, two) = groups.split_at(groups.len() / 2);
                let (left, right) = x.split_at_mut(self.first_row(two) - self.first_row(one));
                let (mut all, more) = rayon::join(|| self.forward(one, left), || self.forward(two, right));
                all.extend(more);
                all
            }
        }
    }

    fn forward_group<const W: usize>(&self, tops: &[u32], x: &mut [[f64; W]]) -> Vec<f64> {
        let symbolic = self.symbolic;
        let (first, last) = (symbolic.subtree_firsts[tops[0] as usize] as usize, tops[tops.len() - 1] as usize);
        let base = symbolic.firsts[first] as usize;
        if tops.len() == 1 && symbolic.subtree_work[last] > symbolic.grain && first < last {
            let groups = symbolic.groups(symbolic.children(last));
            let (inner, own) = x.split_at_mut(symbolic.firsts[last] as usize - base);
            let handed = self.forward(&groups, inner);
            let mut out = self.pool.take();
            out.resize(symbolic.below(last) * W, 0.0);
            let (rows, _) = out.as_chunks_mut::<W>();
            for (group, handed) in groups.iter().zip(&handed) {
                let (mut handed, _) = handed.as_chunks::<W>();
                for &child in *group {
                    let (these, after) = handed.split_at(symbolic.below(child as usize));
                    handed = after;
                    add(symbolic.places(child as usize), these, own, rows);
                }
            }
            down(self.panel(last), own, rows);
            handed.into_iter().for_each(|vector| self.pool.give(vector));
            return out;
        }
        let (mut even, mut odd) = (self.pool.take(), self.pool.take());
        for node in first..=last {
            let (own, others) = if symbolic.odd[node] { (&mut odd, &mut even) } else { (&mut even, &mut odd) };
            let start = own.len();
            own.resize(start + symbolic.below(node) * W, 0.0);
            let (rows, _) = own[start..].as_chunks_mut::<W>();
            let columns = symbolic.columns(node);
            let x = &mut x[columns.start - base..columns.end - base];
            let handed: usize = symbolic.children(node).iter().map(|&child| symbolic.below(child as usize) * W).sum();
            let left = others.len() - handed;
            let (mut updates, _) = others[left..].as_chunks::<W>();
            for &child in symbolic.children(node) {
                let (these, after) = updates.split_at(symbolic.below(child as usize));
                updates = after;
                add(symbolic.places(child as usize), these, x, rows);
            }
            others.truncate(left);
            down(self.panel(node), x, rows);
        }
        let (own, other) = if symbolic.odd[last] { (odd, even) } else { (even, odd) };
        self.pool.give(other);
        own
    }

    /// `L^T x = y` for groups of subtrees; `above` and `beyond` are the parent's own rows and those below it, solved already.
    fn backward<const W: usize>(&self, groups: &[&[u32]], x: &mut [[f64; W]], above: Rows<'_, W>, beyond: Rows<'_, W>) {
        match groups {
            [] => {}
            [group] => self.backward_group(group, x, above, beyond),
            _ => {
                let (one, two) = groups.split_at(groups.len() / 2);
                let (left, right) = x.split_at_mut(self.first_row(two) - self.first_row(one));
                rayon::join(|| self.backward(one, left, above, beyond), || self.backward(two, right, above, beyond));
            }
        }
    }

    fn backward_group<const W: usize>(&self, tops: &[u32], x: &mut [[f64; W]], above: Rows<'_, W>, beyond: Rows<'_, W>) {
        let symbolic = self.symbolic;
        let (first, last) = (symbolic.subtree_firsts[tops[0] as usize] as usize, tops[tops.len() - 1] as usize);
        let base = symbolic.firsts[first] as usize;
        let mut stack = self.pool.take();
        if tops.len() == 1 && symbolic.subtree_work[last] > symbolic.grain && first < last {
            stack.resize(symbolic.below(last) * W, 0.0);
            let (rows, _) = stack.as_chunks_mut::<W>();
            gather(symbolic.places(last), above, beyond, rows);
            let (inner, own) = x.split_at_mut(symbolic.firsts[last] as usize - base);
            up(self.panel(last), own, rows);
            self.backward(&symbolic.groups(symbolic.children(last)), inner, own, rows);
            self.pool.give(stack);
            return;
        }
        // Parents before children: on the stack lie the rows beyond each supernode on the way up from here.
        let mut open: Vec<(u32, usize)> = Vec::new(); // supernode, where its rows start on the stack
        for node in (first..=last).rev() {
            let parent = symbolic.parents[node];
            let top = parent == NONE || parent as usize > last;
            while let Some(&(other, start)) = open.last() {
                if !top && other == parent {
                    break;
                }
                stack.truncate(start);
                open.pop();
            }
            let start = stack.len();
            stack.resize(start + symbolic.below(node) * W, 0.0);
            let (before, own) = stack.split_at_mut(start);
            let (rows, _) = own.as_chunks_mut::<W>();
            match open.last() {
                Some(&(_, start)) if !top => {
                    let (beyond, _) = before[start..].as_chunks::<W>();
                    let columns = symbolic.columns(parent as usize);
                    gather(symbolic.places(node), &x[columns.start - base..columns.end - base], beyond, rows);
                }
                _ => gather(symbolic.places(node), above, beyond, rows),
            }
            open.push((node as u32, start));
            let columns = symbolic.columns(node);
            up(self.panel(node), &mut x[columns.start - base..columns.end - base], rows);
        }
        self.pool.give(stack);
    }
}

/// A factor for each column: 1, or what brings numbers to size 1 whose squares are out of range.
fn units<const W: usize>(rows: &[[f64; W]]) -> [f64; W] {
    let sums = squares(rows, &[1.0; W]);
    std::array::from_fn(|k| {
        if (1e-200..1e200).contains(&sums[k]) {
            return 1.0;
        }
        let most = rows.iter().fold(0.0, |most: f64, row| most.max(row[k].abs()));
        if most > 0.0 && most.is_finite() { (1.0 / most).min(1e300) } else { 1.0 }
    })
}

/// Sum of squares of each column times its unit, grouped in chunks of fixed size.
fn squares<const W: usize>(rows: &[[f64; W]], units: &[f64; W]) -> [f64; W] {
    let parts: Vec<[f64; W]> = rows
        .par_chunks(CHUNK)
        .map(|rows| {
            let mut sums = [0.0; W];
            for row in rows {
                (0..W).for_each(|k| sums[k] += (units[k] * row[k]) * (units[k] * row[k]));
            }
            sums
        })
        .collect();
    let mut sums = [0.0; W];
    parts.iter().for_each(|part| (0..W).for_each(|k| sums[k] += part[k]));
    sums
}

fn add<const W: usize>(places: &[u32], handed: Rows<'_, W>, own: &mut [[f64; W]], below: &mut [[f64; W]]) {
    let columns = own.len();
    for (&place, handed) in places.iter().zip(handed) {
        let place = place as usize;
        let target = if place < columns { &mut own[place] } else { &mut below[place - columns] };
        (0..W).for_each(|k| target[k] += handed[k]);
    }
}

fn gather<const W: usize>(places: &[u32], own: Rows<'_, W>, below: Rows<'_, W>, out: &mut [[f64; W]]) {
    let columns = own.len();
    for (&place, out) in places.iter().zip(out) {
        let place = place as usize;
        *out = if place < columns { own[place] } else { below[place - columns] };
    }
}

/// Forward through one supernode: solves for its own rows, takes their part off the rows below.
fn down<const W: usize>(panel: &[f64], x: &mut [[f64; W]], below: &mut [[f64; W]]) {
    match W {
        1 => vectorized(DownOne { panel, x: x.as_flattened_mut(), below: below.as_flattened_mut() }),
        4 => vectorized(Down::<W, 4> { panel, x, below }),
        _ => vectorized(Down::<W, 8> { panel, x, below }),
    }
}

/// Backward through one supernode.
fn up<const W: usize>(panel: &[f64], x: &mut [[f64; W]], below: &[[f64; W]]) {
    match W {
        1 => vectorized(UpOne { panel, x: x.as_flattened_mut(), below: below.as_flattened() }),
        4 => vectorized(Up::<W, 4> { panel, x, below }),
        _ => vectorized(Up::<W, 8> { panel, x, below }),
    }
}

/// `H` right-hand sides of the `W` are in registers at once.
struct Down<'a, const W: usize, const H: usize> {
    panel: &'a [f64],
    x: &'a mut [[f64; W]],
    below: &'a mut [[f64; W]],
}

impl<const W: usize, const H: usize> Loops<()> for Down<'_, W, H> {
    #[inline(always)]
    fn run<const FUSED: bool>(self) {
        let Down { panel, x, below } = self;
        let columns = x.len();
        let rows = columns + below.len();
        for from in (0..columns).step_by(PANEL) {
            let to = (from + PANEL).min(columns);
            let block = &panel[from * rows..to * rows];
            let (done, rest) = x.split_at_mut(to);
            let own = &mut done[from..];
            for (k, column) in block.chunks_exact(rows).enumerate() {
                let (solved, open) = own.split_at_mut(k + 1);
                let value = &mut solved[k];
                let inverse = 1.0 / column[from + k];
                for t in 0..W {
                    value[t] *= inverse;
                }
                for (target, &factor) in open.iter_mut().zip(&column[from + k + 1..to]) {
                    for t in 0..W {
                        target[t] = minus::<FUSED>(target[t], factor, value[t]);
                    }
                }
            }
            take::<W, H, FUSED>(block, rows, to, own, rest);
            take::<W, H, FUSED>(block, rows, columns, own, below);
        }
    }
}

/// `target -= L x` for the rows of a block of L that start at row `first`.
#[inline(always)]
fn take<const W: usize, const H: usize, const FUSED: bool>(
    block: &[f64],
    rows: usize,
    first: usize,
    x: &[[f64; W]],
    target: &mut [[f64; W]],
) {
    let (fours, rest) = target.as_chunks_mut::<4>();
    let mut row = first;
    for four in fours {
        for half in (0..W).step_by(H) {
            let mut sums = [[0.0; H]; 4];
            for r in 0..4 {
                sums[r].copy_from_slice(&four[r][half..half + H]);
            }
            for (column, x) in block.chunks_exact(rows).zip(x) {
                let (factors, x) = (&column[row..row + 4], &x[half..half + H]);
                for r in 0..4 {
                    for t in 0..H {
                        sums[r][t] = minus::<FUSED>(sums[r][t], factors[r], x[t]);
                    }
                }
            }
            for r in 0..4 {
                four[r][half..half + H].copy_from_slice(&sums[r]);
            }
        }
        row += 4;
    }
    for one in rest {
        for half in (0..W).step_by(H) {
            let mut sums = [0.0; H];
            sums.copy_from_slice(&one[half..half + H]);
            for (column, x) in block.chunks_exact(rows).zip(x) {
                let (factor, x) = (column[row], &x[half..half + H]);
                for t in 0..H {
                    sums[t] = minus::<FUSED>(sums[t], factor, x[t]);
                }
            }
            one[half..half + H].copy_from_slice(&sums);
        }
        row += 1;
    }
}

struct Up<'a, const W: usize, const H: usize> {
    panel: &'a [f64],
    x: &'a mut [[f64; W]],
    below: &'a [[f64; W]],
}

impl<const W: usize, const H: usize> Loops<()> for Up<'_, W, H> {
    #[inline(always)]
    fn run<const FUSED: bool>(self) {
        let Up { panel, x, below } = self;
        let columns = x.len();
        let rows = columns + below.len();
        let mut to = columns;
        while to > 0 {
            // Four columns at a time; what is left over comes last, one by one.
            let from = if to >= 4 { to - 4 } else { to - 1 };
            let (own, solved) = x[from..].split_at_mut(to - from);
            let block = &panel[from * rows..to * rows];
            if let ([a, b, c, d], true) = (&mut *own, to - from == 4) {
                let column = |k: usize| &block[k * rows + to..(k + 1) * rows];
                let (p, q, r, s) = (column(0), column(1), column(2), column(3));
                for half in (0..W).step_by(H) {
                    let mut sums = [[0.0; H]; 4];
                    let near = solved.len();
                    for (begin, source) in [(0, &*solved), (near, below)] {
                        let end = begin + source.len();
                        let (p, q, r, s) = (&p[begin..end], &q[begin..end], &r[begin..end], &s[begin..end]);
                        for ((((x, &p), &q), &r), &s) in source.iter().zip(p).zip(q).zip(r).zip(s) {
                            let (x, factors) = (&x[half..half + H], [p, q, r, s]);
                            for k in 0..4 {
                                for t in 0..H {
                                    sums[k][t] = minus::<FUSED>(sums[k][t], factors[k], x[t]);
                                }
                            }
                        }
                    }
                    for (own, sums) in [&mut *a, &mut *b, &mut *c, &mut *d].into_iter().zip(&sums) {
                        for t in 0..H {
                            own[half + t] += sums[t];
                        }
                    }
                }
            } else {
                let (near, far) = block[to..].split_at(solved.len());
                for (x, &factor) in solved.iter().zip(near) {
                    for t in 0..W {
                        own[0][t] = minus::<FUSED>(own[0][t], factor, x[t]);
                    }
                }
                for (x, &factor) in below.iter().zip(far) {
                    for t in 0..W {
                        own[0][t] = minus::<FUSED>(own[0][t], factor, x[t]);
                    }
                }
            }
            for (k, column) in block.chunks_exact(rows).enumerate().rev() {
                let (open, done) = own.split_at_mut(k + 1);
                let value = &mut open[k];
                for (source, &factor) in done.iter().zip(&column[from + k + 1..to]) {
                    for t in 0..W {
                        value[t] = minus::<FUSED>(value[t], factor, source[t]);
                    }
                }
                let inverse = 1.0 / column[from + k];
                for t in 0..W {
                    value[t] *= inverse;
                }
            }
            to = from;
        }
    }
}

struct DownOne<'a> {
    panel: &'a [f64],
    x: &'a mut [f64],
    below: &'a mut [f64],
}

impl Loops<()> for DownOne<'_> {
    #[inline(always)]
    fn run<const FUSED: bool>(self) {
        let DownOne { panel, x, below } = self;
        let columns = x.len();
        let rows = columns + below.len();
        for from in (0..columns).step_by(4) {
            let to = (from + 4).min(columns);
            let block = &panel[from * rows..to * rows];
            let (done, rest) = x.split_at_mut(to);
            let own = &mut done[from..];
            for (k, column) in block.chunks_exact(rows).enumerate() {
                own[k] /= column[from + k];
                let (value, later) = (own[k], &column[from + k + 1..to]);
                for (x, &factor) in own[k + 1..].iter_mut().zip(later) {
                    *x = minus::<FUSED>(*x, factor, value);
                }
            }
            let parts = [(to, rest), (columns, &mut *below)];
            for (first, target) in parts {
                let size = target.len();
                let column = |k: usize| &block[k * rows + first..][..size];
                if let &mut [a, b, c, d] = own {
                    for ((((target, &p), &q), &r), &s) in target.iter_mut().zip(column(0)).zip(column(1)).zip(column(2)).zip(column(3)) {
                        let sum = minus::<FUSED>(minus::<FUSED>(*target, p, a), q, b);
                        *target = minus::<FUSED>(minus::<FUSED>(sum, r, c), s, d);
                    }
                } else {
                    for (k, &value) in own.iter().enumerate() {
                        for (x, &factor) in target.iter_mut().zip(column(k)) {
                            *x = minus::<FUSED>(*x, factor, value);
                        }
                    }
                }
            }
        }
    }
}

struct UpOne<'a> {
    panel: &'a [f64],
    x: &'a mut [f64],
    below: &'a [f64],
}

impl Loops<()> for UpOne<'_> {
    #[inline(always)]
    fn run<const FUSED: bool>(self) {
        let UpOne { panel, x, below } = self;
        let columns = x.len();
        let rows = columns + below.len();
        for (k, column) in panel.chunks_exact(rows).enumerate().rev() {
            let (open, done) = x.split_at_mut(k + 1);
            let value = open[k] + inner::<FUSED>(&column[k + 1..columns], done) + inner::<FUSED>(&column[columns..], below);
            open[k] = value / column[k];
        }
    }
}

/// Minus the inner product, in eight sums side by side.
#[inline(always)]
fn inner<const FUSED: bool>(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; 8];
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<8>(), b.as_chunks::<8>());
    for (a, b) in a.iter().zip(b) {
        for t in 0..8 {
            sums[t] = minus::<FUSED>(sums[t], a[t], b[t]);
        }
    }
    let mut rest = 0.0;
    for (&a, &b) in a_rest.iter().zip(b_rest) {
        rest = minus::<FUSED>(rest, a, b);
    }
    let [a, b, c, d, e, f, g, h] = sums;
    (((a + e) + (b + f)) + ((c + g) + (d + h))) + rest
}
