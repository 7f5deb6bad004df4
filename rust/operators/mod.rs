//! Discrete operators of a shape: stiffness, mass, gradient, divergence.
