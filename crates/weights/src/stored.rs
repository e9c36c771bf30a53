//! Tensors as described in files: the type and the location of their numbers.

use half::slice::{HalfBitsSliceExt as _, HalfFloatSliceExt as _};
use half::{bf16, f16};
use lsdc_core::weights::Tensor;
use std::rc::Rc;

/// Storage types of floating-point numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum FloatType {
    F32,
    F16,
    Bf16,
}

impl FloatType {
    pub(super) fn of_storage(name: &str) -> Option<Self> {
        match name {
            "FloatStorage" => Some(Self::F32),
            "HalfStorage" => Some(Self::F16),
            "BFloat16Storage" => Some(Self::Bf16),
            _ => None,
        }
    }

    fn bytes(self) -> usize {
        match self {
            Self::F32 => 4,
            Self::F16 | Self::Bf16 => 2,
        }
    }

    /// Reads a little-endian number at the start of some bytes.
    fn value(self, bytes: &[u8]) -> Option<f32> {
        match self {
            Self::F32 => bytes.first_chunk().map(|b| f32::from_le_bytes(*b)),
            Self::F16 => bytes.first_chunk().map(|b| f16::from_le_bytes(*b).to_f32()),
            Self::Bf16 => bytes
                .first_chunk()
                .map(|b| bf16::from_le_bytes(*b).to_f32()),
        }
    }

    /// Returns all numbers; incomplete trailing bytes are dropped.
    pub(super) fn values(self, bytes: &[u8]) -> Vec<f32> {
        if self == Self::F16 {
            // Whole slices are converted with SIMD instructions, as encoders have millions of values.
            let (pairs, _) = bytes.as_chunks::<2>();
            let bits: Vec<u16> = pairs.iter().map(|pair| u16::from_le_bytes(*pair)).collect();
            let halves: &[f16] = bits.reinterpret_cast();
            return halves.to_f32_vec();
        }
        let each = bytes.chunks_exact(self.bytes());
        each.filter_map(|number| self.value(number)).collect()
    }
}

/// A tensor whose values are in a storage.
#[derive(Clone, Debug)]
pub(super) struct StoredTensor {
    pub(super) storage: Rc<str>,
    /// `None` for integers.
    pub(super) kind: Option<FloatType>,
    pub(super) offset: usize,
    pub(super) shape: Vec<usize>,
    pub(super) stride: Vec<usize>,
}

impl StoredTensor {
    /// Returns the size of the values in bytes; `None` if it overflows.
    pub(super) fn bytes(&self, kind: FloatType) -> Option<usize> {
        let mut sides = self.shape.iter();
        let count = sides.try_fold(1_usize, |n, &side| n.checked_mul(side))?;
        count.checked_mul(kind.bytes())
    }

    /// Builds the tensor from the bytes of its storage; `None` if the storage has fewer values.
    pub(super) fn tensor(&self, kind: FloatType, bytes: &[u8]) -> Option<Tensor> {
        if self.stride.len() != self.shape.len() {
            return None;
        }
        let size = self.bytes(kind)?;
        // Checked before allocation: next to an axis of length 0, the others may have any length.
        if size == 0 {
            return Tensor::new(self.shape.clone(), Vec::new());
        }
        let values = bytes.get(self.offset.checked_mul(kind.bytes())?..)?;
        if self.is_row_by_row() {
            return Tensor::new(self.shape.clone(), kind.values(values.get(..size)?));
        }
        if size > values.len() {
            return None;
        }
        let mut offsets = vec![0_usize];
        for (&side, &stride) in self.shape.iter().zip(&self.stride) {
            let mut along = Vec::with_capacity(offsets.len() * side);
            for offset in offsets {
                for i in 0..side {
                    along.push(offset.checked_add(i.checked_mul(stride)?)?);
                }
            }
            offsets = along;
        }
        let mut found = Vec::with_capacity(offsets.len());
        for offset in offsets {
            let start = offset.checked_mul(kind.bytes())?;
            found.push(kind.value(values.get(start..)?)?);
        }
        Tensor::new(self.shape.clone(), found)
    }

    fn is_row_by_row(&self) -> bool {
        let mut step = 1_usize;
        let axes = self.shape.iter().zip(&self.stride).rev();
        axes.into_iter().all(|(&side, &stride)| {
            let follows = side == 1 || stride == step;
            step = step.saturating_mul(side);
            follows
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tensors_are_read_within_their_storage() {
        let stored = |offset: usize, shape: &[usize], stride: &[usize]| StoredTensor {
            storage: "0".into(),
            kind: Some(FloatType::F32),
            offset,
            shape: shape.to_vec(),
            stride: stride.to_vec(),
        };
        let bytes: Vec<u8> = (0..6_u8).flat_map(|v| f32::from(v).to_le_bytes()).collect();
        let read = |stored: StoredTensor| {
            stored
                .tensor(FloatType::F32, &bytes)
                .map(|t| t.values().to_vec())
        };
        assert_eq!(
            read(stored(2, &[2, 2], &[2, 1])),
            Some(vec![2.0, 3.0, 4.0, 5.0])
        );
        assert_eq!(
            read(stored(0, &[2, 1, 3], &[3, 99, 1])).map(|v| v.len()),
            Some(6)
        );
        assert_eq!(read(stored(3, &[2, 2], &[2, 1])), None);
        // Transposed.
        assert_eq!(
            read(stored(0, &[3, 2], &[1, 3])),
            Some(vec![0.0, 3.0, 1.0, 4.0, 2.0, 5.0])
        );
        assert_eq!(read(stored(1, &[3, 2], &[1, 3])), None);
        // Repeated values could take more memory than the file has bytes.
        assert_eq!(read(stored(0, &[7], &[0])), None);
        assert_eq!(read(stored(0, &[2, 2], &[2])), None);
        assert_eq!(read(stored(usize::MAX, &[2], &[1])), None);
        assert_eq!(read(stored(0, &[usize::MAX, 2], &[2, 1])), None);
        // No values, however long the other axes are.
        for (shape, stride) in [
            ([1 << 40, 0], [5, 1]),
            ([1 << 33, 0], [5, 1]),
            ([0, 1 << 40], [1, 5]),
        ] {
            assert_eq!(read(stored(0, &shape, &stride)), Some(vec![]));
        }
        assert_eq!(read(stored(0, &[1 << 40, 1 << 40, 0], &[1, 1, 1])), None);
    }
}
