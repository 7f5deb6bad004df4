//! Dynamic optimal transport.

use crate::convert::{table, vector, vector_out};
use crate::run;
use crate::shrink::{Elements, written};
use beltrami::transport::{self, Domain, Ends, Mobility, Repair, Step};
use numpy::{PyArray1, PyReadonlyArray1, PyReadonlyArray2, PyReadwriteArray2};
use pyo3::prelude::*;
use std::sync::Arc;

/// Simplices and nodal masses of a transport.
#[pyclass(frozen, module = "beltrami._core")]
pub struct TransportDomain {
    domain: Arc<Domain>,
}

#[pymethods]
impl TransportDomain {
    #[new]
    #[pyo3(signature = (elements, mass, coordinates))]
    fn new(
        py: Python<'_>,
        elements: &Elements,
        mass: PyReadonlyArray1<'_, f64>,
        coordinates: Option<PyReadonlyArray2<'_, f64>>,
    ) -> PyResult<Self> {
        let mass = vector(&mass)?;
        let coordinates = coordinates.as_ref().map(|c| table(c)).transpose()?;
        let elements = &elements.elements;
        let domain = run::watched(py, None, |control| Domain::new(elements.clone(), mass.to_vec(), coordinates, control))?;
        Ok(TransportDomain { domain: Arc::new(domain) })
    }

    /// The connected component of each node.
    fn labels<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<u32>> {
        vector_out(py, self.domain.labels().to_vec())
    }

    /// What elements give to their corners, into `mean` and `flux`.
    fn gather(
        &self,
        py: Python<'_>,
        scalar: PyReadonlyArray2<'_, f64>,
        field: PyReadonlyArray2<'_, f64>,
        other: PyReadonlyArray2<'_, f64>,
        factors: PyReadonlyArray1<'_, f64>,
        mut mean: PyReadwriteArray2<'_, f64>,
        mut flux: PyReadwriteArray2<'_, f64>,
    ) -> PyResult<()> {
        let (scalar, field, other) = (table(&scalar)?.0, table(&field)?.0, table(&other)?.0);
        let (factors, mean, flux) = (vector(&factors)?, written(&mut mean, py)?, written(&mut flux, py)?);
        run::brief(py, || self.domain.gather(scalar, field, other, factors, mean, flux))
    }

    /// Densities on elements and intervals into `out`.
    fn densities(&self, py: Python<'_>, nodal: PyReadonlyArray2<'_, f64>, mut out: PyReadwriteArray2<'_, f64>) -> PyResult<()> {
        let (nodal, out) = (table(&nodal)?.0, written(&mut out, py)?);
        run::brief(py, || self.domain.densities(nodal, out))
    }

    /// Gradients of each slice into `out`.
    fn gradients(&self, py: Python<'_>, nodal: PyReadonlyArray2<'_, f64>, mut out: PyReadwriteArray2<'_, f64>) -> PyResult<()> {
        let (nodal, out) = (table(&nodal)?.0, written(&mut out, py)?);
        run::brief(py, || self.domain.gradients(nodal, out))
    }

    /// The Hamiltonian of each slice into `out`.
    fn hamiltonian(
        &self,
        py: Python<'_>,
        potential: PyReadonlyArray2<'_, f64>,
        weights: PyReadonlyArray1<'_, f64>,
        power: f64,
        mut out: PyReadwriteArray2<'_, f64>,
    ) -> PyResult<()> {
        let (potential, weights, out) = (table(&potential)?.0, vector(&weights)?, written(&mut out, py)?);
        run::brief(py, || self.domain.hamiltonian(potential, weights, power, out))
    }

    /// One step on the elements; `momentum`, `dual_density` and `dual_momentum` are written.
    fn step(
        &self,
        py: Python<'_>,
        steps: (f64, f64, f64, f64),
        weights: PyReadonlyArray1<'_, f64>,
        sizes: PyReadonlyArray1<'_, f64>,
        mobility: PyReadonlyArray1<'_, f64>,
        before: PyReadonlyArray2<'_, f64>,
        after: PyReadonlyArray2<'_, f64>,
        potential: PyReadonlyArray2<'_, f64>,
        mut momentum: PyReadwriteArray2<'_, f64>,
        mut dual_density: PyReadwriteArray2<'_, f64>,
        mut dual_momentum: PyReadwriteArray2<'_, f64>,
    ) -> PyResult<()> {
        let (primal, dual, relaxation, power) = steps;
        let how = Step { primal, dual, relaxation, power };
        let sizes = [vector(&weights)?, vector(&sizes)?, vector(&mobility)?];
        let (before, after, potential) = (table(&before)?.0, table(&after)?.0, table(&potential)?.0);
        let (momentum, dual_density) = (written(&mut momentum, py)?, written(&mut dual_density, py)?);
        let dual_momentum = written(&mut dual_momentum, py)?;
        run::brief(py, || self.domain.step(how, sizes, before, after, potential, momentum, dual_density, dual_momentum))
    }

    /// Repairs of a potential by several ways (passes, share, dilated), one below the other in `out`.
    fn repairs(
        &self,
        py: Python<'_>,
        potential: PyReadonlyArray2<'_, f64>,
        weights: PyReadonlyArray1<'_, f64>,
        limit: PyReadonlyArray2<'_, f64>,
        bounded: bool,
        power: f64,
        ways: Vec<(usize, f64, bool)>,
        mut out: PyReadwriteArray2<'_, f64>,
    ) -> PyResult<()> {
        let (potential, weights, limit, out) = (table(&potential)?.0, vector(&weights)?, table(&limit)?.0, written(&mut out, py)?);
        let ways: Vec<Repair> = ways.into_iter().map(|(passes, share, dilated)| Repair { power, passes, share, dilated }).collect();
        run::watched(py, None, |_| self.domain.repairs(potential, weights, limit, bounded, &ways, out))
    }

    /// Momenta of least energy into `out`.
    fn optimal_momentum(
        &self,
        py: Python<'_>,
        conductivity: PyReadonlyArray2<'_, f64>,
        rate: PyReadonlyArray2<'_, f64>,
        mut out: PyReadwriteArray2<'_, f64>,
    ) -> PyResult<()> {
        let (conductivity, rate, out) = (table(&conductivity)?.0, table(&rate)?.0, written(&mut out, py)?);
        run::watched(py, None, |control| self.domain.optimal_momentum(conductivity, rate, out, control))
    }
}

/// The space-time Poisson solver.
#[pyclass(frozen, module = "beltrami._core")]
pub struct SpaceTime {
    domain: Arc<Domain>,
    solver: transport::SpaceTime,
}

#[pymethods]
impl SpaceTime {
    #[new]
    fn new(
        py: Python<'_>,
        domain: &TransportDomain,
        intervals: usize,
        end: Option<f64>,
        nodes: PyReadonlyArray1<'_, f64>,
        elements: PyReadonlyArray1<'_, f64>,
        memory: f64,
    ) -> PyResult<Self> {
        let (domain, ends) = (domain.domain.clone(), end.map_or(Ends::Fixed, Ends::Free));
        let mobility = Mobility { nodes: vector(&nodes)?.to_vec(), elements: vector(&elements)?.to_vec() };
        let solver = run::watched(py, None, |control| transport::SpaceTime::new(&domain, intervals, ends, &mobility, memory, control))?;
        Ok(SpaceTime { domain, solver })
    }

    /// How many factors are kept.
    fn factors(&self) -> usize {
        self.solver.factors()
    }

    /// The potential of a right-hand side (intervals, nodes) into `out`.
    fn solve(&self, py: Python<'_>, right: PyReadonlyArray2<'_, f64>, mut out: PyReadwriteArray2<'_, f64>) -> PyResult<()> {
        let (right, out) = (table(&right)?.0, written(&mut out, py)?);
        run::watched(py, None, |control| self.solver.solve(&self.domain, right, out, control))
    }
}
