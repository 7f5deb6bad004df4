//! Neighbours, closest points and rays.
