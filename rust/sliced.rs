//! Sliced Wasserstein distance between weighted points in R^n, and the rotation that minimizes it.
//!
//! For a unit direction θ both measures are projected onto a line, where the optimal coupling is the monotone one: sort
//! both, then go through the two cumulative masses together. The squared distance is the mean over the directions of
//! `Σ_ij D_ij (x_i·θ - y_j·θ)^2`. With the couplings `D_t` fixed and directions in orthonormal blocks, the rotation `R` that
//! makes `X R` nearest to `Y` is `U V^T` of the singular value decomposition of
//!
//! `H = (1/T) Σ_t X^T D_t Y θ_t θ_t^T`
//!
//! (Rabin, Peyré, Delon, Bernot 2011; the chapter's (8.30)-(8.32)), which [`Alignment::step`] computes.

use crate::control::Control;
use crate::error::{Error, Result};
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Points that are projected together.
const LANES: usize = 8;

/// Directions that one task takes.
const GROUP: usize = 4;

/// Buckets that are sorted together.
const BUCKETS_AT_ONCE: usize = 256;

/// Numbers in a bucket from which on it is sorted in the ordinary way.
const CROWD: usize = 32;

/// A weighted measure as the kernels keep it: blocks of [`LANES`] points, coordinate after coordinate.
#[derive(Debug, Clone)]
struct Measure {
    dimension: usize,
    count: usize,
    blocks: Vec<f64>,
    /// Sum 1; none: all alike.
    weights: Option<Vec<f64>>,
}

impl Measure {
    fn new(name: &str, points: &[f64], dimension: usize, weights: Option<&[f64]>) -> Result<Measure> {
        if dimension == 0 || points.is_empty() || !points.len().is_multiple_of(dimension) {
            return Err(Error::input(format!(
                "the {name} has {} coordinates; at least one point of R^n with n >= 1 is needed (here n = {dimension})",
                points.len()
            )));
        }
        let count = points.len() / dimension;
        if count > u32::MAX as usize / 2 {
            return Err(Error::input(format!("the {name} has {count} points; up to 2^31 - 1 are possible")));
        }
        if let Some(at) = points.iter().position(|number| !number.is_finite()) {
            return Err(Error::input(format!(
                "coordinate {} of point {} of the {name} is {}; remove that point or give it a finite position",
                at % dimension,
                at / dimension,
                points[at]
            )));
        }
        let weights = weights.map(|weights| normalized(name, weights, count)).transpose()?;
        let mut blocks = vec![0.0; count.div_ceil(LANES) * LANES * dimension];
        blocks.par_chunks_mut(LANES * dimension).zip(points.par_chunks(LANES * dimension)).with_min_len(512).for_each(|(block, points)| {
            for (lane, point) in points.chunks_exact(dimension).enumerate() {
                for (axis, &number) in point.iter().enumerate() {
                    block[axis * LANES + lane] = number;
                }
            }
        });
        Ok(Measure { dimension, count, blocks, weights })
    }

    /// `X^T c`.
    fn moment(&self, coefficients: &[f64]) -> Vec<f64> {
        let mut sums = vec![[0.0; LANES]; self.dimension];
        Arch::new().dispatch(Moment { measure: self, coefficients, sums: &mut sums });
        sums.iter().map(|lanes| lanes.iter().sum()).collect()
    }
}

/// Weights divided by their sum. The sum runs in ascending order, so that it does not depend on the order of the points.
fn normalized(name: &str, weights: &[f64], count: usize) -> Result<Vec<f64>> {
    if weights.len() != count {
        return Err(Error::input(format!("{} weights for the {count} points of the {name}", weights.len())));
    }
    if let Some(at) = weights.iter().position(|weight| !(weight.is_finite() && *weight >= 0.0)) {
        return Err(Error::input(format!("weight {at} of the {name} is {}; weights must be finite and at least 0", weights[at])));
    }
    let most = weights.iter().fold(0.0, |most: f64, &weight| most.max(weight));
    if most == 0.0 {
        return Err(Error::input(format!("all weights of the {name} are 0; give at least one point some weight")));
    }
    let mut ascending: Vec<f64> = weights.iter().map(|weight| weight / most).collect();
    ascending.sort_unstable_by(f64::total_cmp);
    let total: f64 = ascending.iter().sum();
    Ok(weights.iter().map(|weight| weight / most / total).collect())
}

struct Project<'a> {
    measure: &'a Measure,
    directions: &'a [f64],
    out: &'a mut [f64],
}

impl WithSimd for Project<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let (dimension, count) = (self.measure.dimension, self.measure.count);
        let stride = count.div_ceil(LANES) * LANES;
        let ways: [&[f64]; GROUP] =
            std::array::from_fn(|way| &self.directions[(way * dimension).min(self.directions.len() - dimension)..][..dimension]);
        let mut outs = self.out.chunks_exact_mut(stride);
        let mut outs: [&mut [f64]; GROUP] = std::array::from_fn(|_| outs.next().unwrap_or_default());
        for (index, block) in self.measure.blocks.chunks_exact(LANES * dimension).enumerate() {
            let mut sums = [[0.0; LANES]; GROUP];
            for (axis, row) in block.chunks_exact(LANES).enumerate() {
                for (sums, way) in sums.iter_mut().zip(&ways) {
                    let factor = way[axis];
                    for lane in 0..LANES {
                        sums[lane] += row[lane] * factor;
                    }
                }
            }
            for (out, sums) in outs.iter_mut().zip(&sums) {
                if let Some(out) = out.get_mut(index * LANES..(index + 1) * LANES) {
                    out.copy_from_slice(sums);
                }
            }
        }
    }
}

struct Moment<'a> {
    measure: &'a Measure,
    coefficients: &'a [f64],
    sums: &'a mut [[f64; LANES]],
}

impl WithSimd for Moment<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let dimension = self.measure.dimension;
        for (block, part) in self.measure.blocks.chunks_exact(LANES * dimension).zip(self.coefficients.chunks(LANES)) {
            let mut factors = [0.0; LANES];
            factors[..part.len()].copy_from_slice(part);
            for (sums, row) in self.sums.iter_mut().zip(block.chunks_exact(LANES)) {
                for lane in 0..LANES {
                    sums[lane] += row[lane] * factors[lane];
                }
            }
        }
    }
}

/// A number to sort by, alone or with the index of its point.
trait Item: Copy + Default + Send {
    fn new(number: f64, index: usize) -> Self;
    fn number(&self) -> f64;
    fn index(&self) -> usize;
    fn order(&self, other: &Self) -> std::cmp::Ordering;
    /// Sorts what lies in its bucket already, equal numbers in order of index. `ends`: of the buckets.
    fn settle(dealt: &mut [Self], ends: &[u32]);
}

impl Item for f64 {
    #[inline(always)]
    fn new(number: f64, _: usize) -> f64 {
        number
    }
    #[inline(always)]
    fn number(&self) -> f64 {
        *self
    }
    #[inline(always)]
    fn index(&self) -> usize {
        0
    }
    #[inline(always)]
    fn order(&self, other: &f64) -> std::cmp::Ordering {
        self.total_cmp(other)
    }

    /// By exchanges of neighbours, the even pairs and the odd ones in turn: as many rounds as the fullest bucket holds numbers, and
    /// no branch that depends on them, so that several pairs go at once.
    #[inline(always)]
    fn settle(dealt: &mut [f64], ends: &[u32]) {
        let mut first = 0;
        for some in ends.chunks(BUCKETS_AT_ONCE) {
            let end = some.last().map_or(first, |&end| end as usize);
            let numbers = &mut dealt[first..end];
            first = end;
            let mut moved = 1;
            for _ in 0..CROWD {
                moved = 0;
                for odd in 0..2 {
                    let (pairs, _) = numbers.get_mut(odd..).unwrap_or_default().as_chunks_mut::<2>();
                    for pair in pairs {
                        let [a, b] = *pair;
                        *pair = if b < a { [b, a] } else { [a, b] };
                        moved |= pair[0].to_bits() ^ a.to_bits();
                    }
                }
                if moved == 0 {
                    break;
                }
            }
            if moved != 0 {
                numbers.sort_unstable_by(f64::total_cmp);
            }
        }
    }
}

impl Item for (f64, u32) {
    #[inline(always)]
    fn new(number: f64, index: usize) -> (f64, u32) {
        (number, index as u32)
    }
    #[inline(always)]
    fn number(&self) -> f64 {
        self.0
    }
    #[inline(always)]
    fn index(&self) -> usize {
        self.1 as usize
    }
    #[inline(always)]
    fn order(&self, other: &(f64, u32)) -> std::cmp::Ordering {
        self.0.total_cmp(&other.0).then(self.1.cmp(&other.1))
    }

    /// By insertion.
    #[inline(always)]
    fn settle(dealt: &mut [(f64, u32)], ends: &[u32]) {
        let mut first = 0;
        for &end in ends {
            if (end - first) as usize > CROWD {
                dealt[first as usize..end as usize].sort_unstable_by(Self::order);
            }
            first = end;
        }
        for at in 1..dealt.len() {
            let item = dealt[at];
            let mut hole = at;
            while hole > 0 && dealt[hole - 1].0 > item.0 {
                dealt[hole] = dealt[hole - 1];
                hole -= 1;
            }
            dealt[hole] = item;
        }
    }
}

/// How the numbers are dealt: the bucket of each, and where each bucket ends.
#[derive(Default)]
struct Deal {
    keys: Vec<u32>,
    ends: Vec<u32>,
}

/// The numbers in ascending order, equal ones by index: dealt into buckets of equal width, about as many as there are numbers, so that
/// most hold a few; what is left to do is [`Item::settle`].
struct Sort<'a, T> {
    numbers: &'a [f64],
    deal: &'a mut Deal,
    sorted: &'a mut Vec<T>,
}

impl<T: Item> WithSimd for Sort<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Sort { numbers, deal: Deal { keys, ends }, sorted } = self;
        let count = numbers.len();
        let (least, most) = bounds(numbers);
        let buckets = count.next_power_of_two().clamp(16, 1 << 17);
        let scale = (buckets - 1) as f64 / (most - least);
        sorted.clear();
        if count < 32 || !(scale.is_finite() && scale > 0.0) {
            sorted.extend(numbers.iter().enumerate().map(|(index, &number)| T::new(number, index)));
            sorted.sort_unstable_by(T::order);
            return;
        }
        keys.clear();
        // added to 2^52 a number has its whole part in the lowest bits
        keys.extend(numbers.iter().map(|number| ((number - least) * scale + (1u64 << 52) as f64).to_bits() as u32));
        ends.clear();
        ends.resize(buckets, 0);
        for &key in keys.iter() {
            ends[key as usize & (buckets - 1)] += 1;
        }
        let mut sum = 0;
        for end in ends.iter_mut() {
            sum += std::mem::replace(end, sum);
        }
        sorted.resize(count, T::default());
        for (index, (&number, &key)) in numbers.iter().zip(keys.iter()).enumerate() {
            let place = &mut ends[key as usize & (buckets - 1)];
            sorted[*place as usize] = T::new(number, index);
            *place += 1;
        }
        // each bucket's start has become its end
        T::settle(sorted, ends);
    }
}

/// The least and the greatest.
#[inline(always)]
fn bounds(numbers: &[f64]) -> (f64, f64) {
    let (mut least, mut most) = ([f64::INFINITY; 16], [f64::NEG_INFINITY; 16]);
    let (chunks, rest) = numbers.as_chunks::<16>();
    for chunk in chunks {
        for lane in 0..16 {
            least[lane] = if chunk[lane] < least[lane] { chunk[lane] } else { least[lane] };
        }
        for lane in 0..16 {
            most[lane] = if chunk[lane] > most[lane] { chunk[lane] } else { most[lane] };
        }
    }
    (least.iter().chain(rest).copied().fold(f64::INFINITY, f64::min), most.iter().chain(rest).copied().fold(f64::NEG_INFINITY, f64::max))
}

fn sort<T: Item>(numbers: &[f64], deal: &mut Deal, sorted: &mut Vec<T>) {
    Arch::new().dispatch(Sort { numbers, deal, sorted });
}

/// A measure on a line, in ascending order.
struct Line<'a, T> {
    sorted: &'a [T],
    /// Masses in the same order; none: `mass` each.
    masses: Option<&'a [f64]>,
    mass: f64,
}

/// Masses of one point in each measure if all of a measure's points are alike, and what to multiply by at the end. Whole
/// numbers where both are uniform: then no difference of masses is ever rounded.
fn unit_masses(source: &Measure, target: &Measure) -> (f64, f64, f64) {
    let (n, m) = (source.count as f64, target.count as f64);
    if source.weights.is_none() && target.weights.is_none() { (m, n, 1.0 / n / m) } else { (1.0 / n, 1.0 / m, 1.0) }
}

/// The monotone coupling of two measures on a line: its cost `Σ D_ij (x_i - y_j)^2`, and for each point of the first the
/// sum `Σ_j D_ij y_j`, handed to `pulled`.
fn couple<T: Item, U: Item>(source: &Line<T>, target: &Line<U>, scale: f64, mut pulled: impl FnMut(&T, f64)) -> f64 {
    let (n, m) = (source.sorted.len(), target.sorted.len());
    let mut cost = 0.0;
    if source.masses.is_none() && target.masses.is_none() && n == m {
        let share = 1.0 / n as f64;
        let mut sums = [0.0; LANES]; // several sums, which the processor can work on at a time
        for (rank, (x, y)) in source.sorted.iter().zip(target.sorted).enumerate() {
            let difference = x.number() - y.number();
            sums[rank % LANES] += difference * difference;
            pulled(x, share * y.number());
        }
        return sums.iter().sum::<f64>() * share;
    }
    let mass_at = |masses: Option<&[f64]>, mass: f64, rank: usize| masses.map_or(mass, |masses| masses[rank]);
    let (mut i, mut j) = (0, 0);
    let (mut left, mut right) = (mass_at(source.masses, source.mass, 0), mass_at(target.masses, target.mass, 0));
    let mut pull = 0.0;
    // when one side has come to its end, what rounding has left of the other is of no weight
    while i < n && j < m {
        let (x, y) = (source.sorted[i].number(), target.sorted[j].number());
        let difference = x - y;
        let (step_source, step_target) = (left <= right, right <= left);
        let mass = if step_source { left } else { right };
        cost += mass * difference * difference;
        pull += mass * y;
        left -= mass;
        right -= mass;
        if step_source {
            pulled(&source.sorted[i], scale * pull);
            pull = 0.0;
            i += 1;
            if i < n {
                left = mass_at(source.masses, source.mass, i);
            }
        }
        if step_target {
            j += 1;
            if j < m {
                right = mass_at(target.masses, target.mass, j);
            }
        }
    }
    if i < n {
        pulled(&source.sorted[i], scale * pull);
    }
    cost * scale
}

fn check_directions(directions: &[f64], dimension: usize) -> Result<usize> {
    if directions.is_empty() || !directions.len().is_multiple_of(dimension) {
        return Err(Error::input(format!("{} coordinates are no directions in R^{dimension}; at least one is needed", directions.len())));
    }
    for (index, direction) in directions.chunks_exact(dimension).enumerate() {
        let square: f64 = direction.iter().map(|number| number * number).sum();
        if square.is_nan() || (square - 1.0).abs() > 1e-6 {
            return Err(Error::input(format!("direction {index} has length {}; divide directions by their lengths", square.sqrt())));
        }
    }
    Ok(directions.len() / dimension)
}

fn check_same(source: &Measure, target: &Measure) -> Result<()> {
    if source.dimension == target.dimension {
        return Ok(());
    }
    Err(Error::input(format!("the source lies in R^{}, the target in R^{}", source.dimension, target.dimension)))
}

fn check_value(value: f64) -> Result<f64> {
    if value.is_finite() {
        return Ok(value);
    }
    Err(Error::numerical("the squared distance overflows; divide all coordinates by a large number"))
}

#[derive(Default)]
struct Scratch {
    projected: Vec<f64>,
    deal: Deal,
    source: Vec<f64>,
    target: Vec<f64>,
    pairs: Vec<(f64, u32)>,
    masses: Vec<f64>,
    target_masses: Vec<f64>,
    pulled: Vec<f64>,
}

/// Projects onto up to [`GROUP`] directions; the row of each is `stride` long.
fn project(measure: &Measure, directions: &[f64], out: &mut Vec<f64>) -> usize {
    let stride = measure.count.div_ceil(LANES) * LANES;
    out.resize(directions.len() / measure.dimension * stride, 0.0);
    Arch::new().dispatch(Project { measure, directions, out });
    stride
}

/// Sorts a measure's projection; with its masses in the same order if it has weights.
fn sorted_line(
    measure: &Measure,
    numbers: &[f64],
    deal: &mut Deal,
    values: &mut Vec<f64>,
    pairs: &mut Vec<(f64, u32)>,
    masses: &mut Vec<f64>,
) {
    masses.clear();
    match &measure.weights {
        None => sort(numbers, deal, values),
        Some(weights) => {
            sort(numbers, deal, pairs);
            values.clear();
            values.extend(pairs.iter().map(|pair| pair.0));
            masses.extend(pairs.iter().map(|pair| weights[pair.1 as usize]));
        }
    }
}

/// The sliced Wasserstein distance (of order 2) between two weighted measures, over given unit directions.
///
/// Points are `dimension` coordinates each, one after the other; so are directions. Numbers of points may differ; weights
/// (none: all alike) are divided by their sums.
///
/// ```
/// use beltrami::{Control, sliced};
/// // a shift by (3, 4) is seen by the two axes as 3 and as 4
/// let (x, y) = ([0.0, 0.0, 1.0, 1.0], [4.0, 5.0, 3.0, 4.0]);
/// let distance = sliced::distance(&x, &y, 2, None, None, &[1.0, 0.0, 0.0, 1.0], &Control::default())?;
/// assert!((distance - 12.5f64.sqrt()).abs() < 1e-15);
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] if a measure has no points, a number is not finite, weights are negative or all 0, or directions are not
/// of length 1; [`Error::Numerical`] if a square overflows; [`Error::Cancelled`].
pub fn distance(
    source: &[f64],
    target: &[f64],
    dimension: usize,
    source_weights: Option<&[f64]>,
    target_weights: Option<&[f64]>,
    directions: &[f64],
    control: &Control,
) -> Result<f64> {
    let source = Measure::new("source", source, dimension, source_weights)?;
    let target = Measure::new("target", target, dimension, target_weights)?;
    let total = check_directions(directions, dimension)?;
    let (source_mass, target_mass, scale) = unit_masses(&source, &target);
    let done = AtomicUsize::new(0);
    let costs: Vec<Vec<f64>> = directions
        .par_chunks(GROUP * dimension)
        .map_init(Scratch::default, |s, group| {
            let mut other = std::mem::take(&mut s.pulled);
            let stride = project(&source, group, &mut s.projected);
            let stride_target = project(&target, group, &mut other);
            let mut costs = Vec::with_capacity(GROUP);
            for way in 0..group.len() / dimension {
                control.report(done.fetch_add(1, Ordering::Relaxed) as f64 / total as f64)?;
                let numbers = &s.projected[way * stride..][..source.count];
                sorted_line(&source, numbers, &mut s.deal, &mut s.source, &mut s.pairs, &mut s.masses);
                let numbers = &other[way * stride_target..][..target.count];
                sorted_line(&target, numbers, &mut s.deal, &mut s.target, &mut s.pairs, &mut s.target_masses);
                let from = Line { sorted: &s.source, masses: source.weights.is_some().then_some(&s.masses), mass: source_mass };
                let to = Line { sorted: &s.target, masses: target.weights.is_some().then_some(&s.target_masses), mass: target_mass };
                costs.push(couple(&from, &to, scale, |_, _| {}));
            }
            s.pulled = other;
            Ok(costs)
        })
        .collect::<Result<_>>()?;
    check_value((costs.iter().flatten().sum::<f64>() / total as f64).sqrt())
}

/// Source, target and directions of an alternation between couplings and rotations; what does not change is kept.
#[derive(Debug, Clone)]
pub struct Alignment {
    source: Measure,
    target: Measure,
    directions: Vec<f64>,
    /// The target's projections in ascending order, direction after direction, and its masses in the same order.
    values: Vec<f64>,
    masses: Vec<f64>,
}

/// What one step of the alternation finds at a rotation.
#[derive(Debug, Clone, PartialEq)]
pub struct Step {
    /// `H = (1/T) Σ_t X^T D_t Y θ_t θ_t^T`, row after row.
    pub cross: Vec<f64>,
    /// The squared sliced distance between `X R` and `Y`.
    pub value: f64,
}

impl Alignment {
    /// Projects and sorts the target. Arguments are those of [`distance`].
    ///
    /// # Errors
    /// Those of [`distance`].
    pub fn new(
        source: &[f64],
        target: &[f64],
        dimension: usize,
        source_weights: Option<&[f64]>,
        target_weights: Option<&[f64]>,
        directions: &[f64],
        control: &Control,
    ) -> Result<Alignment> {
        let source = Measure::new("source", source, dimension, source_weights)?;
        let target = Measure::new("target", target, dimension, target_weights)?;
        check_same(&source, &target)?;
        let total = check_directions(directions, dimension)?;
        let mut values = vec![0.0; total * target.count];
        let mut masses = vec![0.0; if target.weights.is_some() { values.len() } else { 0 }];
        let keep = |s: &mut Scratch, group: &[f64], values: &mut [f64], mut masses: Option<&mut [f64]>| {
            let stride = project(&target, group, &mut s.projected);
            for (way, kept) in values.chunks_exact_mut(target.count).enumerate() {
                control.check()?;
                let numbers = &s.projected[way * stride..][..target.count];
                sorted_line(&target, numbers, &mut s.deal, &mut s.target, &mut s.pairs, &mut s.masses);
                kept.copy_from_slice(&s.target);
                if let Some(masses) = masses.as_deref_mut() {
                    masses[way * target.count..][..target.count].copy_from_slice(&s.masses);
                }
            }
            Ok(())
        };
        let groups = directions.par_chunks(GROUP * dimension).zip(values.par_chunks_mut(GROUP * target.count));
        if target.weights.is_some() {
            groups
                .zip(masses.par_chunks_mut(GROUP * target.count))
                .try_for_each_init(Scratch::default, |s, ((group, values), masses)| keep(s, group, values, Some(masses)))?;
        } else {
            groups.try_for_each_init(Scratch::default, |s, (group, values)| keep(s, group, values, None))?;
        }
        Ok(Alignment { source, target, directions: directions.to_vec(), values, masses })
    }

    /// Dimension of the space.
    pub fn dimension(&self) -> usize {
        self.source.dimension
    }

    /// The coupling at each of several rotations (`dimension` x `dimension`, row after row, one after the other).
    ///
    /// ```
    /// use beltrami::{Control, sliced::Alignment};
    /// let (x, y) = ([1.0, 0.0, 0.0, 2.0], [0.0, 1.0, -2.0, 0.0]); // y is x turned by a quarter
    /// let alignment = Alignment::new(&x, &y, 2, None, None, &[1.0, 0.0, 0.0, 1.0], &Control::default())?;
    /// let found = alignment.step(&[0.0, 1.0, -1.0, 0.0], &Control::default())?;
    /// assert_eq!(found[0].value, 0.0);
    /// # Ok::<(), beltrami::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Input`] if the numbers are no whole number of matrices or not finite; [`Error::Numerical`] if a square
    /// overflows; [`Error::Cancelled`].
    pub fn step(&self, rotations: &[f64], control: &Control) -> Result<Vec<Step>> {
        let dimension = self.dimension();
        let size = dimension * dimension;
        if !rotations.len().is_multiple_of(size) || !rotations.iter().all(|number| number.is_finite()) {
            return Err(Error::input(format!("{} numbers are no finite matrices of R^{dimension}", rotations.len())));
        }
        let total = self.directions.len() / dimension;
        let count = rotations.len() / size;
        // X R θ = X (R θ)
        let mut turned = vec![0.0; count * self.directions.len()];
        for (rotation, out) in rotations.chunks_exact(size).zip(turned.chunks_exact_mut(self.directions.len())) {
            for (direction, out) in self.directions.chunks_exact(dimension).zip(out.chunks_exact_mut(dimension)) {
                for (row, out) in rotation.chunks_exact(dimension).zip(out) {
                    *out = row.iter().zip(direction).map(|(a, b)| a * b).sum();
                }
            }
        }
        let groups = total.div_ceil(GROUP);
        let done = AtomicUsize::new(0);
        let parts: Vec<Vec<(Vec<f64>, f64)>> = (0..count * groups)
            .into_par_iter()
            .map_init(Scratch::default, |s, task| {
                control.report(done.fetch_add(1, Ordering::Relaxed) as f64 / (count * groups) as f64)?;
                let first = task % groups * GROUP;
                let some = GROUP.min(total - first);
                let ways = &turned[(task / groups * total + first) * dimension..][..some * dimension];
                let stride = project(&self.source, ways, &mut s.projected);
                Ok((0..some).map(|way| self.one(way * stride, first + way, s)).collect())
            })
            .collect::<Result<_>>()?;
        let steps = parts.chunks_exact(groups).map(|parts| {
            let mut step = Step { cross: vec![0.0; size], value: 0.0 };
            for ((moment, value), direction) in parts.iter().flatten().zip(self.directions.chunks_exact(dimension)) {
                step.value += value;
                for (row, moment) in step.cross.chunks_exact_mut(dimension).zip(moment) {
                    for (entry, number) in row.iter_mut().zip(direction) {
                        *entry += moment * number;
                    }
                }
            }
            step.cross.iter_mut().for_each(|entry| *entry /= total as f64);
            step.value = check_value(step.value / total as f64)?;
            Ok(step)
        });
        steps.collect()
    }

    /// One direction: `X^T D Y θ` and the cost.
    fn one(&self, offset: usize, direction: usize, s: &mut Scratch) -> (Vec<f64>, f64) {
        let (source, target) = (&self.source, &self.target);
        let (source_mass, target_mass, scale) = unit_masses(source, target);
        let Scratch { projected, deal, pairs, masses, pulled, .. } = s;
        sort(&projected[offset..][..source.count], deal, pairs);
        if let Some(weights) = &source.weights {
            masses.clear();
            masses.extend(pairs.iter().map(|pair| weights[pair.1 as usize]));
        }
        pulled.clear();
        pulled.resize(source.count, 0.0);
        let from = Line { sorted: &pairs[..], masses: source.weights.is_some().then_some(&masses[..]), mass: source_mass };
        let kept = direction * target.count..(direction + 1) * target.count;
        let to = Line { sorted: &self.values[kept.clone()], masses: self.masses.get(kept), mass: target_mass };
        let cost = couple(&from, &to, scale, |pair, pull| pulled[pair.index()] = pull);
        (source.moment(pulled), cost)
    }
}
