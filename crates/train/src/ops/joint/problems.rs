//! What the problems of a batch are, beside tensors.

use lsdc_core::fit::{Adjoint, JointConfig};
use std::sync::{Arc, Mutex};

/// The problems of a batch, as far as they are not tensors.
#[derive(Clone, Debug)]
pub struct Problems(pub(super) Arc<Inner>);

#[derive(Debug)]
pub(super) struct Inner {
    /// Candidate points `y * width + x` of each image.
    pub(super) pixels: Vec<Vec<u32>>,
    pub(super) config: JointConfig,
    /// The number of basis functions, the first ones, whose weights are not penalised.
    pub(super) free: usize,
    /// What the way back needs, problem by problem.
    pub(super) solved: Mutex<Vec<Option<Adjoint>>>,
}

impl Problems {
    /// Nothing of them is solved yet.
    pub(super) fn new(pixels: Vec<Vec<u32>>, config: JointConfig, free: usize) -> Self {
        Self(Arc::new(Inner {
            pixels,
            config,
            free,
            solved: Mutex::default(),
        }))
    }
}
