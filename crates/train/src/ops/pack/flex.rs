//! Parts with memory of their own: flex copies a view whenever a kernel reads it.

use super::{PackBackend, reference_part};
use burn::backend::Flex;
use burn::backend::tensor::FloatTensor;

impl PackBackend for Flex {
    fn part(packed: FloatTensor<Self>, start: usize, length: usize) -> FloatTensor<Self> {
        reference_part::<Self>(packed, start, length).to_contiguous()
    }
}
