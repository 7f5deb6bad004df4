//! Factors of symmetric indefinite matrices, for shifts inside a spectrum: faer's supernodal `L B L^T` with Bunch-Kaufman pivots
//! in each supernode, in the order of our own analysis.

use super::Symbolic;
use crate::control::Control;
use crate::error::{Error, Result};
use crate::sparse::Csr;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::lblt::factor::LbltParams;
use faer::perm::PermRef;
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, IntranodeLbltRef, SymbolicCholesky, SymmetricOrdering, factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Conj, MatMut, Par, Side, Spec};

/// The factor and the matrix, whose residual corrects every solve once.
pub(super) struct Indefinite {
    symbolic: SymbolicCholesky<usize>,
    values: Vec<f64>,
    subdiagonal: Vec<f64>,
    forward: Vec<usize>,
    inverse: Vec<usize>,
    matrix: Csr,
}

impl Indefinite {
    pub(super) fn new(matrix: Csr, coordinates: Option<(&[f64], usize)>, control: &Control) -> Result<Self> {
        let broken = |what: &str| Error::numerical(format!("the shifted matrix of {} rows could not be factored: {what}", matrix.rows()));
        let n = matrix.rows();
        let order: Vec<usize> = Symbolic::new(&matrix, coordinates, control)?.given_order().iter().map(|&old| old as usize).collect();
        let mut position = vec![0; n];
        for (new, &old) in order.iter().enumerate() {
            position[old] = new;
        }
        control.check()?;
        let indices: Vec<usize> = matrix.indices().iter().map(|&column| column as usize).collect();
        // Symmetric: the rows are the columns.
        let pattern = SymbolicSparseColMatRef::new_checked(n, n, matrix.starts(), None, &indices);
        let parameters =
            CholeskySymbolicParams { supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SUPERNODAL, ..Default::default() };
        let ordering = SymmetricOrdering::Custom(PermRef::new_checked(&order, &position, n));
        let symbolic =
            factorize_symbolic_cholesky(pattern, Side::Lower, ordering, parameters).map_err(|error| broken(&format!("{error:?}")))?;
        control.check()?;
        let zeros = |size: usize| {
            let mut numbers: Vec<f64> = Vec::new();
            numbers.try_reserve_exact(size).map_err(|_| broken(&format!("{size} numbers do not fit into memory")))?;
            numbers.resize(size, 0.0);
            Ok::<_, Error>(numbers)
        };
        let (mut values, mut subdiagonal) = (zeros(symbolic.len_val())?, zeros(n)?);
        let (mut forward, mut inverse) = (vec![0; n], vec![0; n]);
        let pivots = Spec::<LbltParams, f64>::default();
        let need = symbolic.factorize_numeric_intranode_lblt_scratch::<f64>(Par::Seq, pivots);
        let mut memory = MemBuffer::try_new(need).map_err(|_| broken("its work space does not fit into memory"))?;
        symbolic.factorize_numeric_intranode_lblt(
            &mut values,
            &mut subdiagonal,
            &mut forward,
            &mut inverse,
            SparseColMatRef::new(pattern, matrix.values()),
            Side::Lower,
            Par::Seq,
            MemStack::new(&mut memory),
            pivots,
        );
        Ok(Indefinite { symbolic, values, subdiagonal, forward, inverse, matrix })
    }

    fn solve_in_place(&self, columns: &mut [f64], width: usize) -> Result<()> {
        let n = self.forward.len();
        let factor =
            IntranodeLbltRef::new(&self.symbolic, &self.values, &self.subdiagonal, PermRef::new_checked(&self.forward, &self.inverse, n));
        let need = self.symbolic.solve_in_place_scratch::<f64>(width, Par::Seq);
        let mut memory = MemBuffer::try_new(need).map_err(|_| Error::numerical("the work space of a solve does not fit into memory"))?;
        factor.solve_in_place_with_conj(
            Conj::No,
            MatMut::from_column_major_slice_mut(columns, n, width),
            Par::Seq,
            MemStack::new(&mut memory),
        );
        Ok(())
    }

    /// Solves for `width` right-hand sides, kept row after row, and corrects once by the residual.
    pub(super) fn solve_block_into(&self, b: &[f64], width: usize, out: &mut [f64]) -> Result<()> {
        let n = self.forward.len();
        let turned = |rows: &[f64]| -> Vec<f64> { (0..width).flat_map(|j| (0..n).map(move |i| rows[i * width + j])).collect() };
        let mut columns = turned(b);
        self.solve_in_place(&mut columns, width)?;
        let add = |columns: &[f64], out: &mut [f64]| {
            for (i, row) in out.chunks_exact_mut(width).enumerate() {
                for (j, number) in row.iter_mut().enumerate() {
                    *number += columns[j * n + i];
                }
            }
        };
        out.fill(0.0);
        add(&columns, out);
        let mut rest = self.matrix.multiply_block(out, width)?;
        rest.iter_mut().zip(b).for_each(|(rest, b)| *rest = b - *rest);
        columns = turned(&rest);
        self.solve_in_place(&mut columns, width)?;
        add(&columns, out);
        Ok(())
    }
}
