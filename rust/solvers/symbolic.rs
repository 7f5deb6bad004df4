//! Analysis of a symmetric pattern: the order, the elimination tree, relaxed supernodes and their rows.
//!
//! Everything here depends on the pattern only, so one analysis serves any number of numeric factorizations.
//! Elimination tree by Liu (1990), column counts by Gilbert, Ng and Peyton (1994).

use super::ordering;
use crate::control::Control;
use crate::error::{Error, Result};
use crate::sparse::Csr;
use rayon::prelude::*;
use std::sync::Arc;

pub(crate) const NONE: u32 = u32::MAX;
const CHUNK: usize = 2048;
const TASKS: f64 = 96.0; // the work is cut into about so many tasks, whatever the number of threads
const LEAST_TASK: f64 = 2e5; // floating-point operations that are worth a task

/// What a sparse Cholesky factorization knows before it has seen a number: order, supernodes, rows.
///
/// One analysis serves any number of matrices of the same pattern, also at the same time on several threads.
#[derive(Debug)]
pub struct Symbolic {
    pub(crate) n: usize,
    /// Pattern of the matrix that was analysed.
    pub(crate) pattern: (Vec<usize>, Vec<u32>),
    /// `order[new] = old`.
    pub(crate) order: Vec<u32>,
    /// `inverse[old] = new`.
    pub(crate) inverse: Vec<u32>,
    /// First column of each supernode, and n.
    pub(crate) firsts: Vec<u32>,
    /// Parent of each supernode, or NONE.
    pub(crate) parents: Vec<u32>,
    /// Where the rows below each supernode start in `rows` and `places`.
    pub(crate) row_starts: Vec<usize>,
    /// Rows below the supernode's own columns, ascending.
    pub(crate) rows: Vec<u32>,
    /// Where each of them is in the parent's front.
    pub(crate) places: Vec<u32>,
    /// Where each supernode's block of the factor starts.
    pub(crate) value_starts: Vec<usize>,
    /// The order before supernodes were formed; the same analysis follows from it again.
    pub(crate) given: Vec<u32>,
    /// The pattern in the new order; columns do not ascend within a row.
    pub(crate) entry_starts: Vec<usize>,
    pub(crate) columns: Vec<u32>,
    /// Row within the front of each entry at or below the diagonal, NONE above it.
    pub(crate) targets: Vec<u32>,
    /// Children of each supernode, ascending.
    pub(crate) child_starts: Vec<u32>,
    pub(crate) children: Vec<u32>,
    /// First supernode of the subtree below each, and the work in it.
    pub(crate) subtree_firsts: Vec<u32>,
    pub(crate) subtree_work: Vec<f64>,
    /// Distance from the root, odd or even: on which of two stacks a supernode's update lies.
    pub(crate) odd: Vec<bool>,
    /// Subtrees of at most this much work are one task.
    pub(crate) grain: f64,
    pub(crate) nonzeros: usize,
}

impl Symbolic {
    /// Analyses the pattern of a symmetric matrix; `coordinates` (n times D numbers, D) place its unknowns and make a better order.
    ///
    /// ```
    /// use beltrami::{Control, Csr, solvers::{Cholesky, Symbolic}};
    /// let matrix = |s: f64| Csr::new(2, 2, vec![0, 2, 4], vec![0, 1, 0, 1], vec![2.0 + s, -1.0, -1.0, 2.0 + s]);
    /// let symbolic = Symbolic::new(&matrix(0.0)?, None, &Control::default())?;
    /// for shift in [0.0, 1.0] {
    ///     let factor = Cholesky::with_symbolic(&symbolic, &matrix(shift)?, &Control::default())?;
    ///     assert!((factor.solve(&[1.0, 1.0])?[0] - 1.0 / (1.0 + shift)).abs() < 1e-15);
    /// }
    /// # Ok::<(), beltrami::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Input`] if the matrix is not square, its pattern is not symmetric, or the coordinates do not fit it;
    /// [`Error::Cancelled`] on request.
    pub fn new(matrix: &Csr, coordinates: Option<(&[f64], usize)>, control: &Control) -> Result<Arc<Self>> {
        let n = matrix.rows();
        if matrix.columns() != n {
            return Err(Error::input(format!(
                "a matrix of {n} rows and {} columns has no Cholesky factor; it must be square",
                matrix.columns()
            )));
        }
        let (starts, indices) = (matrix.starts(), matrix.indices());
        if !same_sums(n, starts, indices, |_| 0) {
            return Err(asymmetric(starts, indices));
        }
        let order = ordering::order(starts, indices, coordinates, control)?;
        control.check()?;
        analyse(n, starts, indices, order, control).map(Arc::new)
    }

    /// The same analysis again from [`Symbolic::given_order`], without looking for an order.
    ///
    /// # Errors
    /// [`Error::Input`] if `order` does not hold each unknown once, and as [`Symbolic::new`].
    pub fn with_order(matrix: &Csr, order: &[u32], control: &Control) -> Result<Arc<Self>> {
        let n = matrix.rows();
        let mut seen = vec![false; n];
        let each_once =
            order.len() == n && order.iter().all(|&old| seen.get_mut(old as usize).is_some_and(|seen| !std::mem::replace(seen, true)));
        if matrix.columns() != n || !each_once {
            return Err(Error::input(format!("an order of {} unknowns does not hold each of {n} rows once", order.len())));
        }
        if !same_sums(n, matrix.starts(), matrix.indices(), |_| 0) {
            return Err(asymmetric(matrix.starts(), matrix.indices()));
        }
        analyse(n, matrix.starts(), matrix.indices(), order.to_vec(), control).map(Arc::new)
    }

    /// The fill-reducing order that was found: unknown eliminated at each step, before equal steps were gathered in supernodes.
    pub fn given_order(&self) -> &[u32] {
        &self.given
    }

    /// Number of unknowns.
    pub fn unknowns(&self) -> usize {
        self.n
    }

    /// Numbers kept in the factor: entries of its lower triangle, with the zeros that fill its dense blocks.
    pub fn nnz(&self) -> usize {
        self.nonzeros
    }

    /// An error unless the matrix has the pattern that was analysed.
    pub(crate) fn fits(&self, matrix: &Csr) -> Result<()> {
        if matrix.rows() != self.n || matrix.columns() != self.n {
            return Err(Error::input(format!(
                "a matrix of {} x {} cannot use the analysis of one of {} x {}; make a new factor",
                matrix.rows(),
                matrix.columns(),
                self.n,
                self.n
            )));
        }
        if matrix.starts() != self.pattern.0 || matrix.indices() != self.pattern.1 {
            let row = (0..self.n).find(|&row| matrix.row(row).0 != &self.pattern.1[self.pattern.0[row]..self.pattern.0[row + 1]]);
            return Err(Error::input(format!(
                "row {} of the matrix has entries in other columns than the matrix that was analysed; make a new factor, or keep explicit zeros",
                row.unwrap_or(0)
            )));
        }
        Ok(())
    }

    pub(crate) fn supernodes(&self) -> usize {
        self.parents.len()
    }

    /// Columns of a supernode.
    pub(crate) fn columns(&self, node: usize) -> std::ops::Range<usize> {
        self.firsts[node] as usize..self.firsts[node + 1] as usize
    }

    /// Number of rows below a supernode's own.
    pub(crate) fn below(&self, node: usize) -> usize {
        self.row_starts[node + 1] - self.row_starts[node]
    }

    pub(crate) fn places(&self, node: usize) -> &[u32] {
        &self.places[self.row_starts[node]..self.row_starts[node + 1]]
    }

    pub(crate) fn children(&self, node: usize) -> &[u32] {
        &self.children[self.child_starts[node] as usize..self.child_starts[node + 1] as usize]
    }

    /// The supernodes without a parent.
    pub(crate) fn roots(&self) -> &[u32] {
        &self.children[self.child_starts[self.supernodes()] as usize..]
    }

    /// Children in consecutive groups: a group is one task. Many small subtrees make one group, a big one stands alone.
    pub(crate) fn groups<'a>(&self, children: &'a [u32]) -> Vec<&'a [u32]> {
        let mut groups = Vec::new();
        let (mut begin, mut sum) = (0, 0.0);
        for (at, &child) in children.iter().enumerate() {
            let work = self.subtree_work[child as usize];
            if at > begin && sum + work > self.grain {
                groups.push(&children[begin..at]);
                (begin, sum) = (at, 0.0);
            }
            sum += work;
        }
        if begin < children.len() {
            groups.push(&children[begin..]);
        }
        groups
    }
}

/// Fills `out`, whose part for item k is `bounds[k]..bounds[k + 1]`, in parallel over chunks of items.
fn fill<T: Send>(out: &mut [T], bounds: &[usize], work: impl Fn(std::ops::Range<usize>, &mut [T]) + Sync) {
    fn halves<T: Send>(
        out: &mut [T],
        bounds: &[usize],
        range: std::ops::Range<usize>,
        work: &(impl Fn(std::ops::Range<usize>, &mut [T]) + Sync),
    ) {
        if range.len() <= CHUNK {
            return work(range, out);
        }
        let middle = range.start + range.len() / 2;
        let (left, right) = out.split_at_mut(bounds[middle] - bounds[range.start]);
        rayon::join(|| halves(left, bounds, range.start..middle, work), || halves(right, bounds, middle..range.end, work));
    }
    halves(out, bounds, 0..bounds.len() - 1, &work);
}

fn sums(counts: impl Iterator<Item = usize>) -> Vec<usize> {
    let mut total = 0;
    std::iter::once(0)
        .chain(counts.map(|count| {
            total += count;
            total
        }))
        .collect()
}

fn inverse(order: &[u32]) -> Vec<u32> {
    let mut inverse = vec![0; order.len()];
    order.iter().enumerate().for_each(|(new, &old)| inverse[old as usize] = new as u32);
    inverse
}

/// Lists of children from parents, ascending; the last list holds the roots.
fn children_of(parents: &[u32]) -> (Vec<u32>, Vec<u32>) {
    let n = parents.len();
    let slot = |parent: u32| if parent == NONE { n } else { parent as usize };
    let mut starts = vec![0u32; n + 2];
    parents.iter().for_each(|&parent| starts[slot(parent) + 1] += 1);
    (0..=n).for_each(|at| starts[at + 1] += starts[at]);
    let mut next = starts.clone();
    let mut children = vec![0u32; n];
    for (child, &parent) in parents.iter().enumerate() {
        let at = &mut next[slot(parent)];
        children[*at as usize] = child as u32;
        *at += 1;
    }
    (starts, children)
}

/// Nodes in an order in which each follows its children.
fn postorder(starts: &[u32], children: &[u32]) -> Vec<u32> {
    let n = children.len();
    // A node before its children, the last child first, written from the end.
    let mut post = vec![0; n];
    let mut at = n;
    let mut stack: Vec<u32> = children[starts[n] as usize..].to_vec();
    while let Some(node) = stack.pop() {
        at -= 1;
        post[at] = node;
        stack.extend_from_slice(&children[starts[node as usize] as usize..starts[node as usize + 1] as usize]);
    }
    post
}

/// The pattern with rows and columns renamed.
fn renamed(starts: &[usize], indices: &[u32], order: &[u32]) -> (Vec<usize>, Vec<u32>) {
    let place = inverse(order);
    let bounds = sums(order.iter().map(|&old| starts[old as usize + 1] - starts[old as usize]));
    let mut columns = vec![0u32; indices.len()];
    fill(&mut columns, &bounds, |range, out| {
        let source = order[range].iter().flat_map(|&old| &indices[starts[old as usize]..starts[old as usize + 1]]);
        out.iter_mut().zip(source).for_each(|(out, &column)| *out = place[column as usize]);
    });
    (bounds, columns)
}

fn elimination_tree(starts: &[usize], indices: &[u32]) -> Vec<u32> {
    let n = starts.len() - 1;
    let mut parents = vec![NONE; n];
    let mut ancestors = vec![NONE; n];
    for k in 0..n {
        for &column in &indices[starts[k]..starts[k + 1]] {
            let mut node = column as usize;
            while node < k {
                let next = std::mem::replace(&mut ancestors[node], k as u32);
                if next == NONE {
                    parents[node] = k as u32;
                    break;
                }
                node = next as usize;
            }
        }
    }
    parents
}

/// Entries of each column of the factor, the diagonal included.
fn column_counts(starts: &[usize], indices: &[u32], parents: &[u32], post: &[u32]) -> Vec<u32> {
    let n = parents.len();
    let mut first = vec![NONE; n]; // first descendant, as a place in `post`
    let mut change = vec![0i64; n];
    for (at, &node) in post.iter().enumerate() {
        change[node as usize] = i64::from(first[node as usize] == NONE);
        let mut up = node;
        while up != NONE && first[up as usize] == NONE {
            first[up as usize] = at as u32;
            up = parents[up as usize];
        }
    }
    let mut last_first = vec![NONE; n]; // largest first descendant seen in this row's subtree
    let mut last_leaf = vec![NONE; n];
    let mut ancestors: Vec<u32> = (0..n as u32).collect();
    for &node in post {
        let node = node as usize;
        if parents[node] != NONE {
            change[parents[node] as usize] -= 1;
        }
        for &row in &indices[starts[node]..starts[node + 1]] {
            let row = row as usize;
            if row <= node || (last_first[row] != NONE && first[node] <= last_first[row]) {
                continue;
            }
            last_first[row] = first[node];
            let before = std::mem::replace(&mut last_leaf[row], node as u32);
            change[node] += 1;
            if before != NONE {
                let mut common = before;
                while common != ancestors[common as usize] {
                    common = ancestors[common as usize];
                }
                let mut up = before;
                while up != common {
                    up = std::mem::replace(&mut ancestors[up as usize], common);
                }
                change[common as usize] -= 1;
            }
        }
        if parents[node] != NONE {
            ancestors[node] = parents[node];
        }
    }
    for &node in post {
        if parents[node as usize] != NONE {
            change[parents[node as usize] as usize] += change[node as usize];
        }
    }
    change.into_iter().map(|count| count.max(1) as u32).collect()
}

/// Numbers in the columns of a supernode: a triangle and the rows below.
fn trapezoid(columns: f64, below: f64) -> f64 {
    columns * (columns + 1.0) / 2.0 + columns * below
}

/// Whether a child joins its parent: few zeros come in, or both are so small that a zero costs less than a visit.
fn joins(columns: f64, zeros: f64, total: f64) -> bool {
    let share = zeros / total;
    (columns <= 4.0 && share < 0.9) || (columns <= 16.0 && share < 0.5) || (columns <= 48.0 && share < 0.12) || share < 0.05
}

/// For each column the top column of its supernode.
fn supernodes(parents: &[u32], counts: &[u32], post: &[u32]) -> Vec<u32> {
    let n = parents.len();
    let mut top: Vec<u32> = (0..n as u32).collect();
    let mut widths = vec![1u32; n];
    let mut claimed = vec![false; n];
    // A column joins its parent if nothing but itself is lost from its rows: no zero comes in.
    for &node in post {
        let node = node as usize;
        let parent = parents[node];
        if parent != NONE && counts[node] == counts[parent as usize] + 1 && !claimed[parent as usize] {
            claimed[parent as usize] = true;
            top[node] = parent;
            widths[parent as usize] += widths[node];
        }
    }
    for &node in post.iter().rev() {
        let above = top[node as usize];
        top[node as usize] = top[above as usize];
    }
    // Relaxation, children before parents: the cheapest child first.
    let mut zeros = vec![0.0f64; n];
    let mut absorbed: Vec<u32> = (0..n as u32).collect();
    let tree: Vec<u32> =
        (0..n).map(|node| if top[node] == node as u32 && parents[node] != NONE { top[parents[node] as usize] } else { NONE }).collect();
    let mut starts = vec![0u32; n + 1];
    tree.iter().filter(|&&parent| parent != NONE).for_each(|&parent| starts[parent as usize + 1] += 1);
    (0..n).for_each(|at| starts[at + 1] += starts[at]);
    let mut next = starts.clone();
    let mut children = vec![0u32; starts[n] as usize];
    let mut candidates: Vec<(f64, u32)> = Vec::new();
    for &node in post {
        let node = node as usize;
        if top[node] != node as u32 {
            continue;
        }
        candidates.clear();
        let below = f64::from(counts[node] - 1);
        let own = f64::from(widths[node]);
        for &child in &children[starts[node] as usize..next[node] as usize] {
            let (columns, under) = (f64::from(widths[child as usize]), f64::from(counts[child as usize] - 1));
            candidates.push((trapezoid(own + columns, below) - trapezoid(own, below) - trapezoid(columns, under), child));
        }
        candidates.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        for &(_, child) in &candidates {
            let (columns, under) = (f64::from(widths[child as usize]), f64::from(counts[child as usize] - 1));
            let own = f64::from(widths[node]);
            let total = trapezoid(own + columns, below);
            let more = total - trapezoid(own, below) - trapezoid(columns, under) + zeros[node] + zeros[child as usize];
            if joins(own + columns, more, total) {
                absorbed[child as usize] = node as u32;
                widths[node] += widths[child as usize];
                zeros[node] = more;
            }
        }
        if tree[node] != NONE {
            let at = &mut next[tree[node] as usize];
            children[*at as usize] = node as u32;
            *at += 1;
        }
    }
    for &node in post.iter().rev() {
        let above = absorbed[node as usize];
        absorbed[node as usize] = absorbed[above as usize];
    }
    top.iter().map(|&top| absorbed[top as usize]).collect()
}

fn analyse(n: usize, starts: &[usize], indices: &[u32], given: Vec<u32>, control: &Control) -> Result<Symbolic> {
    let order = &given;
    let (bounds, columns) = renamed(starts, indices, order);
    let parents = elimination_tree(&bounds, &columns);
    control.check()?;
    let (child_starts, children) = children_of(&parents);
    let post = postorder(&child_starts, &children);
    let counts = column_counts(&bounds, &columns, &parents, &post);
    drop((columns, bounds, child_starts, children));
    control.check()?;
    let top = supernodes(&parents, &counts, &post);

    // Supernodes, numbered by their top columns in postorder; then a postorder of their own tree.
    let mut number = vec![NONE; n];
    let mut tops = Vec::new();
    for &node in &post {
        if top[node as usize] == node {
            number[node as usize] = tops.len() as u32;
            tops.push(node);
        }
    }
    let tree: Vec<u32> = tops
        .iter()
        .map(|&node| if parents[node as usize] == NONE { NONE } else { number[top[parents[node as usize] as usize] as usize] })
        .collect();
    let (child_starts, children) = children_of(&tree);
    let outer = postorder(&child_starts, &children);
    let count = outer.len();
    let place = inverse(&outer);
    let parents: Vec<u32> =
        outer.iter().map(|&node| if tree[node as usize] == NONE { NONE } else { place[tree[node as usize] as usize] }).collect();
    let mut widths = vec![0usize; count];
    top.iter().for_each(|&top| widths[place[number[top as usize] as usize] as usize] += 1);
    let column_starts = sums(widths.iter().copied());
    let firsts: Vec<u32> = column_starts.iter().map(|&start| start as u32).collect();
    let mut next = column_starts;
    let mut final_order = vec![0u32; n];
    for &node in &post {
        let at = &mut next[place[number[top[node as usize] as usize] as usize] as usize];
        final_order[*at] = order[node as usize];
        *at += 1;
    }
    let row_starts = sums(outer.iter().map(|&node| counts[tops[node as usize] as usize] as usize - 1));
    drop((post, counts, top, number, tops, tree, outer, place));
    control.check()?;

    let order = final_order;
    let (entry_starts, columns) = renamed(starts, indices, &order);
    let (child_starts, children) = children_of(&parents);
    let mut subtree_firsts: Vec<u32> = (0..count as u32).collect();
    let mut subtree_work = vec![0.0f64; count];
    let mut value_starts = Vec::with_capacity(count + 1);
    value_starts.push(0usize);
    let mut nonzeros = 0;
    for node in 0..count {
        let (columns, below) = ((firsts[node + 1] - firsts[node]) as usize, row_starts[node + 1] - row_starts[node]);
        let size = columns.checked_mul(columns + below).and_then(|size| size.checked_add(value_starts[node]));
        value_starts
            .push(size.ok_or_else(|| Error::input("the factor has more numbers than memory has addresses; use an iterative solver"))?);
        nonzeros += columns * (columns + 1) / 2 + columns * below;
        let (columns, below) = (columns as f64, below as f64);
        subtree_work[node] +=
            columns * (columns * columns / 3.0 + columns * below + below * below) + 20.0 * (columns + below) + below * below;
        if let Some(&first) = children.get(child_starts[node] as usize..child_starts[node + 1] as usize).and_then(|list| list.first()) {
            subtree_firsts[node] = subtree_firsts[first as usize];
        }
        if parents[node] != NONE {
            subtree_work[parents[node] as usize] += subtree_work[node];
        }
    }
    let total: f64 = (0..count).filter(|&node| parents[node] == NONE).map(|node| subtree_work[node]).sum();
    let mut odd = vec![false; count];
    for node in (0..count).rev() {
        if parents[node] != NONE {
            odd[node] = !odd[parents[node] as usize];
        }
    }
    let inverse = inverse(&order);
    let mut symbolic = Symbolic {
        n,
        pattern: (starts.to_vec(), indices.to_vec()),
        order,
        firsts,
        inverse,
        parents,
        rows: vec![0; row_starts[count]],
        places: vec![0; row_starts[count]],
        row_starts,
        value_starts,
        given,
        entry_starts,
        columns,
        targets: Vec::new(),
        child_starts,
        children,
        subtree_firsts,
        subtree_work,
        odd,
        grain: (total / TASKS).max(LEAST_TASK),
        nonzeros,
    };
    let mut rows = std::mem::take(&mut symbolic.rows);
    rows_of(&symbolic, 0..count, symbolic.roots(), &mut rows)?;
    symbolic.rows = rows;
    control.check()?;
    let mut places = std::mem::take(&mut symbolic.places);
    fill(&mut places, &symbolic.row_starts, |range, out| places_of(&symbolic, range, out));
    symbolic.places = places;
    control.check()?;
    symbolic.targets = targets(&symbolic);
    Ok(symbolic)
}

/// Rows of the supernodes `range`, the subtrees of `tops`, into their part of the list.
fn rows_of(symbolic: &Symbolic, range: std::ops::Range<usize>, tops: &[u32], out: &mut [u32]) -> Result<()> {
    let work: f64 = tops.iter().map(|&top| symbolic.subtree_work[top as usize]).sum();
    if tops.len() > 1 && work > symbolic.grain {
        let middle = tops.len() / 2;
        let split = symbolic.subtree_firsts[tops[middle] as usize] as usize;
        let (left, right) = out.split_at_mut(symbolic.row_starts[split] - symbolic.row_starts[range.start]);
        let (one, two) = rayon::join(
            || rows_of(symbolic, range.start..split, &tops[..middle], left),
            || rows_of(symbolic, split..range.end, &tops[middle..], right),
        );
        return one.and(two);
    }
    if let (&[top], true) = (tops, work > symbolic.grain) {
        let own = symbolic.row_starts[top as usize] - symbolic.row_starts[range.start];
        rows_of(symbolic, range.start..top as usize, symbolic.children(top as usize), &mut out[..own])?;
        return merge(symbolic, range.start, top as usize..top as usize + 1, out);
    }
    merge(symbolic, range.start, range, out)
}

/// Rows of some supernodes by merging their children's with the matrix's own; `out` starts at supernode `base`.
fn merge(symbolic: &Symbolic, base: usize, nodes: std::ops::Range<usize>, out: &mut [u32]) -> Result<()> {
    let (mut found, mut other): (Vec<u32>, Vec<u32>) = (Vec::new(), Vec::new());
    for node in nodes {
        let columns = symbolic.columns(node);
        found.clear();
        let entries = &symbolic.columns[symbolic.entry_starts[columns.start]..symbolic.entry_starts[columns.end]];
        found.extend(entries.iter().filter(|&&row| row as usize >= columns.end));
        found.sort_unstable();
        found.dedup();
        let at = |node: usize| symbolic.row_starts[node] - symbolic.row_starts[base];
        let (before, rest) = out.split_at_mut(at(node));
        for &child in symbolic.children(node) {
            let list = &before[at(child as usize)..at(child as usize + 1)];
            let skip = list.partition_point(|&row| (row as usize) < columns.end);
            unite(&found, &list[skip..], &mut other);
            std::mem::swap(&mut found, &mut other);
        }
        let wanted = symbolic.below(node);
        if found.len() != wanted {
            return Err(Error::numerical("the analysis of the pattern contradicts itself; this is a bug in beltrami, please report it"));
        }
        rest[..wanted].copy_from_slice(&found);
    }
    Ok(())
}

/// Whether the entries above the diagonal and those below it are the same set, by the sums of their hashes: one pass, no search.
pub(crate) fn same_sums(n: usize, starts: &[usize], indices: &[u32], more: impl Fn(usize) -> u64 + Sync) -> bool {
    let mix = |x: u64| {
        let x = (x ^ (x >> 32)).wrapping_mul(0xd6e8_feb8_6659_fd93);
        let x = (x ^ (x >> 32)).wrapping_mul(0xd6e8_feb8_6659_fd93);
        x ^ (x >> 32)
    };
    let difference = (0..n)
        .into_par_iter()
        .with_min_len(CHUNK)
        .map(|row| {
            let mut sum = 0u64;
            let first = starts[row];
            for (at, &column) in indices[first..starts[row + 1]].iter().enumerate() {
                let (entry, column) = (first + at, column as usize);
                let (low, high) = (row.min(column), row.max(column));
                let hash = mix(((low as u64) << 32 | high as u64).wrapping_add(more(entry).wrapping_mul(0x9e37_79b9_7f4a_7c15)));
                sum = match row.cmp(&column) {
                    std::cmp::Ordering::Less => sum.wrapping_add(hash),
                    std::cmp::Ordering::Greater => sum.wrapping_sub(hash),
                    std::cmp::Ordering::Equal => sum,
                };
            }
            sum
        })
        .reduce(|| 0, u64::wrapping_add);
    difference == 0
}

/// The error for a pattern that is not symmetric.
fn asymmetric(starts: &[usize], indices: &[u32]) -> Error {
    for row in 0..starts.len() - 1 {
        for &column in &indices[starts[row]..starts[row + 1]] {
            if indices[starts[column as usize]..starts[column as usize + 1]].binary_search(&(row as u32)).is_err() {
                return Error::input(format!(
                    "the matrix has an entry ({row}, {column}) and none at ({column}, {row}); store both triangles of a symmetric matrix"
                ));
            }
        }
    }
    Error::input("the matrix is not symmetric")
}

/// The union of two ascending lists.
fn unite(a: &[u32], b: &[u32], out: &mut Vec<u32>) {
    out.clear();
    let (mut i, mut j) = (0, 0);
    while i < a.len() && j < b.len() {
        let (x, y) = (a[i], b[j]);
        out.push(x.min(y));
        i += usize::from(x <= y);
        j += usize::from(y <= x);
    }
    out.extend_from_slice(&a[i..]);
    out.extend_from_slice(&b[j..]);
}

/// Where the rows of some supernodes are in their parents' fronts.
fn places_of(symbolic: &Symbolic, nodes: std::ops::Range<usize>, out: &mut [u32]) {
    let base = symbolic.row_starts[nodes.start];
    for node in nodes {
        let parent = symbolic.parents[node];
        if parent == NONE {
            continue;
        }
        let parent = parent as usize;
        let columns = symbolic.columns(parent);
        let above = &symbolic.rows[symbolic.row_starts[parent]..symbolic.row_starts[parent + 1]];
        let range = symbolic.row_starts[node]..symbolic.row_starts[node + 1];
        let mut at = 0;
        for (out, &row) in out[range.start - base..range.end - base].iter_mut().zip(&symbolic.rows[range]) {
            *out = if (row as usize) < columns.end {
                row - columns.start as u32
            } else {
                while at < above.len() && above[at] < row {
                    at += 1;
                }
                (columns.len() + at) as u32
            };
        }
    }
}

/// For each entry of the matrix in the new order, its row within the front of its column's supernode.
fn targets(symbolic: &Symbolic) -> Vec<u32> {
    let starts = &symbolic.entry_starts;
    let mut targets = vec![NONE; symbolic.columns.len()];
    let by_node: Vec<usize> = symbolic.firsts.iter().map(|&first| starts[first as usize]).collect();
    fill(&mut targets, &by_node, |nodes, out| {
        let base = by_node[nodes.start];
        for node in nodes {
            let columns = symbolic.columns(node);
            let below = &symbolic.rows[symbolic.row_starts[node]..symbolic.row_starts[node + 1]];
            for column in columns.clone() {
                for entry in starts[column]..starts[column + 1] {
                    let row = symbolic.columns[entry] as usize;
                    if row >= column {
                        let at = if row < columns.end {
                            row - columns.start
                        } else {
                            columns.len() + below.partition_point(|&r| (r as usize) < row)
                        };
                        out[entry - base] = at as u32;
                    }
                }
            }
        }
    });
    targets
}
