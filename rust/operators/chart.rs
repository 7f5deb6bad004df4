//! Coordinates of a star that are conformal to third order.

use crate::vector::length;

/// The map from tangential coordinates to conformal ones of the fitted surface, to third order.
///
/// Normal coordinates are y = t + (h(t) · h(t, t)) / 6, with h the second fundamental form. They keep distances from the star's own
/// point but not circles; with S the Schouten tensor (half the Gaussian curvature of a surface), z = y + S(y, y) y / 3 - |y|² S y / 6
/// are normal coordinates of a metric that is conformal to the surface's and flat at the point: circumspheres there are circumspheres
/// here, so that the stars of all points see the same Delaunay simplices but for terms of the next order. (On a sphere: stereographic
/// projection.)
pub(super) struct Chart {
    dimension: usize,
    /// h_ab · h_cd
    products: [[f64; 6]; 6],
    schouten: [[f64; 3]; 3],
}

/// Where h_ab stands among the pairs a <= b.
const PAIRS: [[[usize; 3]; 3]; 3] = [[[0; 3]; 3], [[0, 1, 0], [1, 2, 0], [0; 3]], [[0, 1, 2], [1, 3, 4], [2, 4, 5]]];

impl Chart {
    /// From the coefficients of t_a t_b, a <= b, in the fit of the normal components.
    pub(super) fn new(bends: &[f64], ambient: usize, dimension: usize) -> Chart {
        let pair = &PAIRS[dimension - 1];
        let mut factors = [1.0; 6];
        (0..dimension).for_each(|a| factors[pair[a][a]] = 2.0);
        let mut products = [[0.0; 6]; 6];
        let vectors: Vec<&[f64]> = bends.chunks_exact(ambient).collect();
        for p in 0..vectors.len() {
            for q in 0..=p {
                let dot: f64 = vectors[p].iter().zip(vectors[q]).map(|(x, y)| x * y).sum();
                products[p][q] = factors[p] * factors[q] * dot;
                products[q][p] = products[p][q];
            }
        }
        let mut ricci = [[0.0; 3]; 3];
        let mut scalar = 0.0;
        for a in 0..dimension {
            for b in 0..dimension {
                for c in 0..dimension {
                    ricci[a][b] += products[pair[c][c]][pair[a][b]] - products[pair[a][c]][pair[b][c]];
                }
            }
            scalar += ricci[a][a];
        }
        let mut schouten = [[0.0; 3]; 3];
        for a in 0..dimension {
            match dimension {
                2 => schouten[a][a] = scalar / 4.0,
                3 => {
                    schouten[a] = ricci[a];
                    schouten[a][a] -= scalar / 4.0;
                }
                _ => {}
            }
        }
        Chart { dimension, products, schouten }
    }

    /// |h(t, t)|².
    pub(super) fn bend(&self, t: [f64; 3]) -> f64 {
        let (d, pair) = (self.dimension, &PAIRS[self.dimension - 1]);
        let indices = || (0..d).flat_map(move |a| (0..d).map(move |b| (a, b)));
        indices().map(|(a, b)| indices().map(|(c, e)| t[a] * t[b] * t[c] * t[e] * self.products[pair[a][b]][pair[c][e]]).sum::<f64>()).sum()
    }

    /// The mean sectional curvature of a three-dimensional cloud.
    pub(super) fn sectional(&self) -> f64 {
        // the trace of the Schouten tensor is a quarter of the scalar curvature, which is six times the mean
        (0..self.dimension).map(|a| self.schouten[a][a]).sum::<f64>() * 4.0 / 6.0
    }

    /// Sum of the |h_ab|².
    pub(super) fn bending(&self) -> f64 {
        let pair = &PAIRS[self.dimension - 1];
        (0..self.dimension).flat_map(|a| (0..self.dimension).map(move |b| pair[a][b])).map(|p| self.products[p][p]).sum()
    }

    pub(super) fn straighten(&self, t: [f64; 3]) -> [f64; 3] {
        let (d, pair) = (self.dimension, &PAIRS[self.dimension - 1]);
        // h(t, t) · h_p for each pair p
        let mut along = [0.0; 6];
        for a in 0..d {
            for b in 0..d {
                for p in 0..d * (d + 1) / 2 {
                    along[p] += t[a] * t[b] * self.products[pair[a][b]][p];
                }
            }
        }
        let square: f64 = t.iter().map(|t| t * t).sum();
        let (mut bent, mut stretch) = ([0.0; 3], 0.0);
        for a in 0..d {
            for b in 0..d {
                bent[a] += t[b] * (along[pair[a][b]] - square * self.schouten[a][b]) / 6.0;
                stretch += t[a] * t[b] * self.schouten[a][b] / 3.0;
            }
        }
        let change: [f64; 3] = std::array::from_fn(|a| bent[a] + stretch * t[a]);
        let size = length(change);
        let share = (0.4 * square.sqrt() / size).min(1.0);
        std::array::from_fn(|a| t[a] + share * change[a])
    }
}
