//! Instruction sets, and the selection of one for this processor.

use super::{Kernel, Portable, Vector};
use std::fmt;
use std::sync::OnceLock;

/// Name of the environment variable that selects a level.
const VARIABLE: &str = "LSDC_SIMD";

/// An instruction set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// Plain arrays, vectorised by the compiler.
    Portable,
    /// 8 lanes in two registers, with fused multiply-add: every 64-bit Arm processor.
    Neon,
    /// 8 lanes, with fused multiply-add.
    Avx2,
    /// 16 lanes.
    Avx512,
}

impl Level {
    /// All levels, slowest first.
    pub const ALL: [Self; 4] = [Self::Portable, Self::Neon, Self::Avx2, Self::Avx512];

    /// The name, as used in the environment variable `LSDC_SIMD`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Portable => "portable",
            Self::Neon => "neon",
            Self::Avx2 => "avx2",
            Self::Avx512 => "avx512",
        }
    }

    /// The levels available on this processor, slowest first.
    pub fn available() -> impl DoubleEndedIterator<Item = Self> {
        Self::ALL.into_iter().filter(|level| level.is_available())
    }

    /// The level selected by the environment variable `LSDC_SIMD`. If it is unset, or names an unavailable level, this is the
    /// fastest available level; [`Self::selected`] returns an error in the latter case.
    pub fn here() -> Self {
        match Self::choice() {
            Ok(level) => *level,
            Err(_) => Self::fastest(),
        }
    }

    /// The level of [`Self::here`]. `LSDC_SIMD` is read once, at the first use.
    ///
    /// # Errors
    /// `LSDC_SIMD` names a level that does not exist, or that this processor does not have. An empty name counts as unset.
    ///
    /// ```
    /// use lsdc_kernels::simd::Level;
    /// match Level::selected() {
    ///     Ok(level) => assert!(level.is_available()),
    ///     Err(error) => assert!(error.hint().contains("`portable`")),
    /// }
    /// ```
    pub fn selected() -> Result<Self, UnavailableLevel> {
        Self::choice().clone()
    }

    fn choice() -> &'static Result<Self, UnavailableLevel> {
        static CHOICE: OnceLock<Result<Level, UnavailableLevel>> = OnceLock::new();
        CHOICE.get_or_init(|| {
            let name = std::env::var_os(VARIABLE).unwrap_or_default();
            Self::named(&name.to_string_lossy())
        })
    }

    /// Returns the available level with this name; the fastest if the name is empty.
    fn named(name: &str) -> Result<Self, UnavailableLevel> {
        if name.is_empty() {
            return Ok(Self::fastest());
        }
        let level = Self::available().find(|level| level.name() == name);
        level.ok_or_else(|| UnavailableLevel {
            name: name.to_owned(),
        })
    }

    fn fastest() -> Self {
        Self::available().next_back().unwrap_or(Self::Portable)
    }

    /// Whether this processor has the instruction set.
    pub fn is_available(self) -> bool {
        match self {
            Self::Portable => true,
            #[cfg(target_arch = "aarch64")]
            Self::Neon => std::arch::is_aarch64_feature_detected!("neon"),
            #[cfg(not(target_arch = "aarch64"))]
            Self::Neon => false,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma"),
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => is_x86_feature_detected!("avx512f"),
            #[cfg(not(target_arch = "x86_64"))]
            Self::Avx2 | Self::Avx512 => false,
        }
    }

    /// Number of floats in a vector.
    pub(crate) fn lanes(self) -> usize {
        match self {
            Self::Portable | Self::Neon | Self::Avx2 => 8,
            Self::Avx512 => 16,
        }
    }

    /// Returns the number of floats per row of a panel, for a matrix with this many columns: one vector if they fit, else two.
    pub(crate) fn panel(self, columns: usize) -> usize {
        let lanes = self.lanes();
        if columns <= lanes { lanes } else { 2 * lanes }
    }

    /// Runs a computation compiled for the level's instructions. It must be inlined to benefit.
    pub fn vectorised<T>(self, computation: impl FnOnce() -> T) -> T {
        // SAFETY: plain code has the same effect on any processor.
        unsafe { self.run(Plain(computation)) }
    }

    /// Runs a kernel with the vectors of this level.
    ///
    /// # Panics
    /// If this processor does not have the instruction set.
    ///
    /// # Safety
    /// The kernel's requirements must be met.
    pub(crate) unsafe fn run<K: Kernel>(self, kernel: K) -> K::Output {
        assert!(self.is_available(), "{} is not available", self.name());
        // SAFETY: the processor has the instructions; the caller meets the other requirements.
        unsafe {
            match self {
                #[cfg(target_arch = "x86_64")]
                Self::Avx512 => super::x86::avx512(kernel),
                #[cfg(target_arch = "x86_64")]
                Self::Avx2 => super::x86::avx2(kernel),
                #[cfg(target_arch = "aarch64")]
                Self::Neon => super::aarch64::neon(kernel),
                _ => kernel.run::<Portable>(),
            }
        }
    }
}

/// `LSDC_SIMD` names an instruction set that this processor does not have.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UnavailableLevel {
    name: String,
}

impl UnavailableLevel {
    /// A suggestion for what to do.
    pub fn hint(&self) -> String {
        let names: Vec<_> = Level::available()
            .map(|level| format!("`{}`", level.name()))
            .collect();
        format!("unset `{VARIABLE}`, or set it to {}", names.join(" or "))
    }
}

impl fmt::Display for UnavailableLevel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = &self.name;
        write!(
            f,
            "`{VARIABLE}` names an instruction set that this processor does not have: `{name}`"
        )
    }
}

impl std::error::Error for UnavailableLevel {}

/// A computation in plain code.
struct Plain<F>(F);

impl<T, F: FnOnce() -> T> Kernel for Plain<F> {
    type Output = T;

    #[inline(always)]
    unsafe fn run<V: Vector>(self) -> T {
        (self.0)()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_are_found_by_name() {
        for level in Level::available() {
            assert_eq!(Level::named(level.name()), Ok(level));
        }
        assert_eq!(Level::named(""), Ok(Level::fastest()));
    }

    #[test]
    fn levels_that_the_processor_lacks_are_errors() {
        let lacking = Level::ALL.into_iter().filter(|level| !level.is_available());
        for name in lacking.map(Level::name).chain(["sse", "NEON"]) {
            let error = Level::named(name).unwrap_err();
            assert!(
                error.to_string().ends_with(&format!(": `{name}`")),
                "{error}"
            );
            assert!(!error.hint().contains(&format!("`{name}`")));
        }
    }

    /// An architecture has its own levels only.
    #[test]
    fn every_64_bit_arm_processor_has_neon() {
        assert_eq!(Level::Neon.is_available(), cfg!(target_arch = "aarch64"));
        if cfg!(target_arch = "aarch64") {
            assert_eq!(Level::fastest(), Level::Neon);
        }
    }
}
