//! Instruction sets of this processor.

use super::{Kernel, Portable, Vector};
use std::sync::OnceLock;

/// An instruction set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// Plain arrays, as the compiler vectorises them.
    Portable,
    /// 8 lanes, with fused multiply-add.
    Avx2,
    /// 16 lanes.
    Avx512,
}

impl Level {
    /// All levels, slowest first.
    pub const ALL: [Self; 3] = [Self::Portable, Self::Avx2, Self::Avx512];

    /// The name, as the environment variable `LSDC_SIMD` has it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Portable => "portable",
            Self::Avx2 => "avx2",
            Self::Avx512 => "avx512",
        }
    }

    /// The levels that this processor has, slowest first.
    pub fn available() -> impl DoubleEndedIterator<Item = Self> {
        Self::ALL.into_iter().filter(|level| level.is_available())
    }

    /// The fastest that this processor has, or the one that `LSDC_SIMD` names if it has that.
    pub fn here() -> Self {
        static LEVEL: OnceLock<Level> = OnceLock::new();
        *LEVEL.get_or_init(|| {
            let name = std::env::var("LSDC_SIMD").unwrap_or_default();
            let named = Self::available().find(|level| level.name() == name);
            let fastest = Self::available().next_back();
            named.or(fastest).unwrap_or(Self::Portable)
        })
    }

    /// Whether this processor has it.
    pub fn is_available(self) -> bool {
        match self {
            Self::Portable => true,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma"),
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => is_x86_feature_detected!("avx512f"),
            #[cfg(not(target_arch = "x86_64"))]
            Self::Avx2 | Self::Avx512 => false,
        }
    }

    /// Floats in a vector.
    pub(crate) fn lanes(self) -> usize {
        match self {
            Self::Portable | Self::Avx2 => 8,
            Self::Avx512 => 16,
        }
    }

    /// Floats of a panel of a matrix with that many columns: one vector if they fit, else two.
    pub(crate) fn panel(self, columns: usize) -> usize {
        let lanes = self.lanes();
        if columns <= lanes { lanes } else { 2 * lanes }
    }

    /// Runs a computation compiled for the level's instructions; it must be inlined to gain by it.
    pub fn vectorised<T>(self, computation: impl FnOnce() -> T) -> T {
        // SAFETY: plain code does what it does on any processor.
        unsafe { self.run(Plain(computation)) }
    }

    /// Runs a kernel with the vectors of this level.
    ///
    /// # Panics
    /// If this processor does not have them.
    ///
    /// # Safety
    /// The kernel's own requirements.
    pub(crate) unsafe fn run<K: Kernel>(self, kernel: K) -> K::Output {
        assert!(self.is_available(), "{} is not available", self.name());
        // SAFETY: the processor has the instructions; the caller meets the other requirements.
        unsafe {
            match self {
                #[cfg(target_arch = "x86_64")]
                Self::Avx512 => super::x86::avx512(kernel),
                #[cfg(target_arch = "x86_64")]
                Self::Avx2 => super::x86::avx2(kernel),
                _ => kernel.run::<Portable>(),
            }
        }
    }
}

/// Code that names no vector.
struct Plain<F>(F);

impl<T, F: FnOnce() -> T> Kernel for Plain<F> {
    type Output = T;

    #[inline(always)]
    unsafe fn run<V: Vector>(self) -> T {
        (self.0)()
    }
}
