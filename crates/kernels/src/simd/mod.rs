//! Building blocks of fast CPU kernels: vectors of every instruction set, selected at run time, matrix products of rows with
//! packed weights, and reusable memory of threads.

/// Defines inlined functions of a vector.
macro_rules! inlined {
    ($(fn $name:ident($($argument:tt)*) $(-> $output:ty)? { $($body:tt)* })*) => {
        $(
            #[inline(always)]
            #[allow(unused_unsafe)]
            unsafe fn $name($($argument)*) $(-> $output)? {
                // SAFETY: as demanded from the caller.
                unsafe { $($body)* }
            }
        )*
    };
}

#[cfg(target_arch = "aarch64")]
mod aarch64;
mod doubles;
mod level;
mod memory;
mod product;
mod rows;
#[cfg(test)]
mod tests;
#[cfg(target_arch = "x86_64")]
mod x86;

pub(crate) use doubles::{Doubles, PortableDoubles};
pub use level::{Level, UnavailableLevel};
pub use memory::{Buffer, Scratch};
pub(crate) use memory::{Shared, Unset, unset, written};
pub use product::{Packed, Tail};
pub(crate) use product::{Rows, product};
pub(crate) use rows::write_blends;
pub use rows::{Blend, blend_rows, dot_rows};

/// Lanes of the longest vector of any level.
const MAX_LANES: usize = 16;

/// A vector of floats.
///
/// # Safety
/// All functions require a processor with the instructions of the implementor, and a calling function compiled for them (see
/// `Level::run`); pointers must be valid for `LANES` floats.
pub(crate) trait Vector: Copy {
    /// Number of floats in a vector; at most 16.
    const LANES: usize;
    /// Number of rows of two vectors that fit the registers, together with two vectors and a broadcast.
    const ROWS: usize;
    /// The f64 vector of the same instruction set.
    type Doubles: Doubles;

    unsafe fn load(from: *const f32) -> Self;
    unsafe fn store(self, to: *mut f32);
    unsafe fn splat(value: f32) -> Self;
    unsafe fn add(self, other: Self) -> Self;
    unsafe fn sub(self, other: Self) -> Self;
    unsafe fn mul(self, other: Self) -> Self;
    unsafe fn max(self, other: Self) -> Self;
    /// Returns `self * factor + term`, rounded once if the processor has a fused operation.
    unsafe fn mul_add(self, factor: Self, term: Self) -> Self;
    /// Returns `self` where `other` is above 0, else 0.
    unsafe fn where_positive(self, other: Self) -> Self;

    /// Copies a float in memory to all lanes.
    #[inline(always)]
    unsafe fn broadcast(from: *const f32) -> Self {
        // SAFETY: as demanded from the caller.
        unsafe { Self::splat(*from) }
    }

    /// Loads the first `count` floats, at most `LANES`; the rest is 0.
    #[inline(always)]
    unsafe fn load_some(from: *const f32, count: usize) -> Self {
        // SAFETY: as demanded from the caller.
        unsafe {
            if count >= Self::LANES {
                return Self::load(from);
            }
            let mut buffer = [0.0; MAX_LANES];
            std::ptr::copy_nonoverlapping(from, buffer.as_mut_ptr(), count);
            Self::load(buffer.as_ptr())
        }
    }

    /// Writes the first `count` floats, at most `LANES`.
    #[inline(always)]
    unsafe fn store_some(self, to: *mut f32, count: usize) {
        // SAFETY: as demanded from the caller.
        unsafe {
            if count >= Self::LANES {
                return self.store(to);
            }
            let mut buffer = [0.0; MAX_LANES];
            self.store(buffer.as_mut_ptr());
            std::ptr::copy_nonoverlapping(buffer.as_ptr(), to, count);
        }
    }

    /// Returns the sum of all lanes.
    #[inline(always)]
    unsafe fn total(self) -> f32 {
        let mut buffer = [0.0; MAX_LANES];
        // SAFETY: as demanded from the caller.
        unsafe { self.store(buffer.as_mut_ptr()) };
        // By halves, like the reductions of vector units.
        let mut half = MAX_LANES / 2;
        while half > 0 {
            for i in 0..half {
                buffer[i] += buffer[i + half];
            }
            half /= 2;
        }
        buffer[0]
    }
}

/// A computation written for any vector.
pub(crate) trait Kernel {
    type Output;

    /// # Safety
    /// As for the functions of `V`.
    unsafe fn run<V: Vector>(self) -> Self::Output;
}

/// An array that the compiler may keep in registers.
#[derive(Clone, Copy)]
struct Portable([f32; 8]);

impl Portable {
    #[inline(always)]
    fn zip(self, other: Self, f: impl Fn(f32, f32) -> f32) -> Self {
        Self(std::array::from_fn(|i| f(self.0[i], other.0[i])))
    }
}

impl Vector for Portable {
    const LANES: usize = 8;
    const ROWS: usize = 4;
    type Doubles = PortableDoubles;

    inlined! {
        fn load(from: *const f32) -> Self { Self(from.cast::<[f32; 8]>().read_unaligned()) }
        fn store(self, to: *mut f32) { to.cast::<[f32; 8]>().write_unaligned(self.0); }
        fn splat(value: f32) -> Self { Self([value; 8]) }
        fn add(self, other: Self) -> Self { self.zip(other, |a, b| a + b) }
        fn sub(self, other: Self) -> Self { self.zip(other, |a, b| a - b) }
        fn mul(self, other: Self) -> Self { self.zip(other, |a, b| a * b) }
        fn max(self, other: Self) -> Self { self.zip(other, |a, b| if a > b { a } else { b }) }
        fn mul_add(self, factor: Self, term: Self) -> Self {
            self.zip(factor, |a, b| a * b).zip(term, |a, b| a + b)
        }
        fn where_positive(self, other: Self) -> Self {
            self.zip(other, |a, b| if b > 0.0 { a } else { 0.0 })
        }
    }
}
