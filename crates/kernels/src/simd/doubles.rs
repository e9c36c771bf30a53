//! Vectors of f64.

/// A vector of f64.
///
/// # Safety
/// As for [`super::Vector`]; pointers must be valid for `LANES` values.
pub(crate) trait Doubles: Copy {
    /// Number of values in a vector: 4 or 8.
    const LANES: usize;
    /// Largest number of row vectors, at most 3, that fits the registers with four columns of sums, or eight for longer
    /// vectors.
    const ROWS: usize = 3;

    unsafe fn load(from: *const f64) -> Self;
    unsafe fn store(self, to: *mut f64);
    unsafe fn splat(value: f64) -> Self;
    unsafe fn mul(self, other: Self) -> Self;
    unsafe fn div(self, other: Self) -> Self;
    unsafe fn sqrt(self) -> Self;
    /// Returns `self - a * b`, rounded once if the processor has a fused operation.
    unsafe fn less_product(self, a: Self, b: Self) -> Self;
}

/// An array that the compiler may keep in registers.
#[derive(Clone, Copy)]
pub(crate) struct PortableDoubles([f64; 4]);

impl Doubles for PortableDoubles {
    const LANES: usize = 4;

    inlined! {
        fn load(from: *const f64) -> Self { Self(from.cast::<[f64; 4]>().read_unaligned()) }
        fn store(self, to: *mut f64) { to.cast::<[f64; 4]>().write_unaligned(self.0); }
        fn splat(value: f64) -> Self { Self([value; 4]) }
        fn mul(self, other: Self) -> Self {
            Self(std::array::from_fn(|i| self.0[i] * other.0[i]))
        }
        fn div(self, other: Self) -> Self {
            Self(std::array::from_fn(|i| self.0[i] / other.0[i]))
        }
        fn sqrt(self) -> Self { Self(self.0.map(f64::sqrt)) }
        fn less_product(self, a: Self, b: Self) -> Self {
            Self(std::array::from_fn(|i| self.0[i] - a.0[i] * b.0[i]))
        }
    }
}
