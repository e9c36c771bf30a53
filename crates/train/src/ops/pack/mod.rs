//! Many vectors as parts of one, so that operations on all of them are one launch on a GPU instead of one for each.

#[cfg(feature = "wgpu")]
mod cube;
mod flex;
#[cfg(test)]
mod tests;

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Dispatch, TensorMetadata as _, backend_extension};
use burn::tensor::{Slice, Tensor};

/// Parts start at multiples of this many values: of 256 bytes, so that GPUs can read them in place.
pub const ALIGNMENT: usize = 64;
/// Parts copied by one launch. Together with the vector they are 8 buffers, the default limit of WebGPU.
const PARTS: usize = 7;

/// The first value and the length of each part in a vector; a part of length 0 is not copied.
pub type Places = [(usize, usize); PARTS];

/// Backends that copy parts of vectors. Not differentiable.
#[backend_extension(
    Flex,
    NdArray: cfg(feature = "ndarray"),
    Cube: cfg(feature = "wgpu"),
)]
pub trait PackBackend: Backend {
    /// Copies vectors to their places in `packed`, which shares its memory with no other tensor.
    fn pack(
        packed: FloatTensor<Self>,
        a: FloatTensor<Self>,
        b: FloatTensor<Self>,
        c: FloatTensor<Self>,
        d: FloatTensor<Self>,
        e: FloatTensor<Self>,
        f: FloatTensor<Self>,
        g: FloatTensor<Self>,
        places: Places,
    ) -> FloatTensor<Self> {
        reference::<Self>(packed, [a, b, c, d, e, f, g], places)
    }

    /// Returns `length` values of a vector from `start` on.
    fn part(packed: FloatTensor<Self>, start: usize, length: usize) -> FloatTensor<Self> {
        reference_part::<Self>(packed, start, length)
    }
}

fn reference<B: Backend>(
    packed: FloatTensor<B>,
    parts: [FloatTensor<B>; PARTS],
    places: Places,
) -> FloatTensor<B> {
    let parts = parts.into_iter().zip(places);
    parts.fold(packed, |packed, (part, (start, length))| {
        if length == 0 {
            return packed;
        }
        debug_assert_eq!(part.shape().num_elements(), length);
        B::float_slice_assign(packed, &[range(start, length)], part)
    })
}

fn reference_part<B: Backend>(
    packed: FloatTensor<B>,
    start: usize,
    length: usize,
) -> FloatTensor<B> {
    B::float_slice(packed, &[range(start, length)])
}

/// Copies any number of vectors to their places in `packed`, which shares its memory with no other tensor.
pub(super) fn pack_parts<B: PackBackend>(
    packed: FloatTensor<B>,
    parts: &[FloatTensor<B>],
    places: &[(usize, usize)],
) -> FloatTensor<B> {
    let chunks = parts.chunks(PARTS).zip(places.chunks(PARTS));
    chunks.fold(packed, |packed, (parts, places)| {
        let part = |i: usize| parts.get(i).unwrap_or(&parts[0]).clone();
        let place = |i: usize| places.get(i).copied().unwrap_or((0, 0));
        B::pack(
            packed,
            part(0),
            part(1),
            part(2),
            part(3),
            part(4),
            part(5),
            part(6),
            std::array::from_fn(place),
        )
    })
}

fn range(start: usize, length: usize) -> Slice {
    Slice::from(start..start + length)
}

/// Where the parts of a vector are. Values between parts are 0.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Layout {
    places: Vec<(usize, usize)>,
    size: usize,
}

impl Layout {
    /// Adds parts of the same length, one after the other, of which the first is aligned.
    pub fn push(&mut self, count: usize, length: usize) {
        let parts = (0..count).map(|i| (self.size + i * length, length));
        self.places.extend(parts);
        self.size = (self.size + count * length).next_multiple_of(ALIGNMENT);
    }

    /// Returns the number of values, a multiple of [`ALIGNMENT`].
    pub fn size(&self) -> usize {
        self.size
    }

    /// Returns the first value and the length of each part.
    pub fn places(&self) -> &[(usize, usize)] {
        &self.places
    }

    /// Copies vectors to one vector; there is at least one, and they are not on an autodiff device.
    pub fn pack(&self, parts: &[Tensor<1>]) -> Tensor<1> {
        debug_assert_eq!(parts.len(), self.places.len());
        let like = (&parts[0].device(), parts[0].dtype());
        let packed = Tensor::<1>::zeros([self.size], like).into_dispatch();
        let parts: Vec<_> = parts.iter().cloned().map(Tensor::into_dispatch).collect();
        Tensor::from_dispatch(pack_parts::<Dispatch>(packed, &parts, &self.places))
    }

    /// Returns a part of a vector. On a GPU, it shares the memory of the vector if its start is aligned.
    pub fn part(&self, packed: &Tensor<1>, index: usize) -> Tensor<1> {
        let (start, length) = self.places[index];
        let packed = packed.clone().into_dispatch();
        Tensor::from_dispatch(Dispatch::part(packed, start, length))
    }
}
