//! The data of a batch of problems that is not in tensors.

use lsdc_core::fit::{Adjoint, JointConfig};
use std::sync::{Arc, Mutex};

/// The data of a batch of problems that is not in tensors.
#[derive(Clone, Debug)]
pub struct Problems(pub(super) Arc<Inner>);

#[derive(Debug)]
pub(super) struct Inner {
    /// Candidate points `y * width + x` of each image.
    pub(super) pixels: Vec<Vec<u32>>,
    pub(super) config: JointConfig,
    /// Number of leading basis functions whose weights are not penalised.
    pub(super) free: usize,
    /// Data for the backward pass, problem by problem.
    pub(super) solved: Mutex<Vec<Option<Adjoint>>>,
}

impl Problems {
    /// Creates a batch without solutions.
    pub(super) fn new(pixels: Vec<Vec<u32>>, config: JointConfig, free: usize) -> Self {
        Self(Arc::new(Inner {
            pixels,
            config,
            free,
            solved: Mutex::default(),
        }))
    }
}
