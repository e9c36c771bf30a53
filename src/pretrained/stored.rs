//! Tensors as files describe them: how their numbers are stored, and where.

use half::{bf16, f16};
use lsdc_core::weights::Tensor;
use std::rc::Rc;

/// How numbers are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    F32,
    F16,
    Bf16,
}

impl Kind {
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

    /// Numbers in the order of the least byte first; what is left of a number is dropped.
    pub(super) fn values(self, bytes: &[u8]) -> Vec<f32> {
        let (fours, _) = bytes.as_chunks::<4>();
        let (twos, _) = bytes.as_chunks::<2>();
        match self {
            Self::F32 => fours.iter().map(|b| f32::from_le_bytes(*b)).collect(),
            Self::F16 => twos
                .iter()
                .map(|b| f16::from_le_bytes(*b).to_f32())
                .collect(),
            Self::Bf16 => twos
                .iter()
                .map(|b| bf16::from_le_bytes(*b).to_f32())
                .collect(),
        }
    }
}

/// A tensor whose values are elsewhere.
#[derive(Clone, Debug)]
pub(super) struct Stored {
    pub(super) storage: Rc<str>,
    /// `None` for whole numbers.
    pub(super) kind: Option<Kind>,
    pub(super) offset: usize,
    pub(super) shape: Vec<usize>,
    pub(super) stride: Vec<usize>,
}

impl Stored {
    /// The tensor, from the bytes of its storage; `None` if it has not as many values.
    pub(super) fn tensor(&self, kind: Kind, bytes: &[u8]) -> Option<Tensor> {
        let count = self
            .shape
            .iter()
            .try_fold(1_usize, |n, &side| n.checked_mul(side))?;
        let start = self.offset.checked_mul(kind.bytes())?;
        let values = bytes.get(start..)?;
        if count > values.len() / kind.bytes() || self.stride.len() != self.shape.len() {
            return None;
        }
        if self.is_row_by_row() {
            let values = &values[..count * kind.bytes()];
            return Tensor::new(self.shape.clone(), kind.values(values));
        }
        let values = kind.values(values);
        let mut places = vec![0_usize];
        for (&side, &stride) in self.shape.iter().zip(&self.stride) {
            let mut along = Vec::with_capacity(places.len() * side);
            for place in places {
                for i in 0..side {
                    along.push(place.checked_add(i.checked_mul(stride)?)?);
                }
            }
            places = along;
        }
        let values = places.into_iter().map(|place| values.get(place).copied());
        Tensor::new(self.shape.clone(), values.collect::<Option<_>>()?)
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
        let stored = |offset: usize, shape: &[usize], stride: &[usize]| Stored {
            storage: "0".into(),
            kind: Some(Kind::F32),
            offset,
            shape: shape.to_vec(),
            stride: stride.to_vec(),
        };
        let bytes: Vec<u8> = (0..6_u8).flat_map(|v| f32::from(v).to_le_bytes()).collect();
        let read = |stored: Stored| {
            stored
                .tensor(Kind::F32, &bytes)
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
        // The same value again and again would be more than the file has.
        assert_eq!(read(stored(0, &[7], &[0])), None);
        assert_eq!(read(stored(0, &[2, 2], &[2])), None);
        assert_eq!(read(stored(usize::MAX, &[2], &[1])), None);
        assert_eq!(read(stored(0, &[usize::MAX, 2], &[2, 1])), None);
    }
}
