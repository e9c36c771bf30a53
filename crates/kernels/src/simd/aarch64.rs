//! Vectors for 64-bit Arm: pairs of the 128-bit registers of NEON.
//!
//! A pair has the lanes of an AVX2 vector, so that every sum has the same order. Tiles of six rows of pairs need fewer loads
//! per product than tiles of twelve rows of single registers, which have equally many sums.

use super::{Doubles, Kernel, Vector};
#[allow(clippy::wildcard_imports)]
use std::arch::aarch64::*;

/// # Safety
/// The processor must have NEON, and the kernel's requirements must be met.
#[target_feature(enable = "neon")]
pub(super) unsafe fn neon<K: Kernel>(kernel: K) -> K::Output {
    // SAFETY: this function is compiled for the vectors' instructions.
    unsafe { kernel.run::<Neon>() }
}

#[derive(Clone, Copy)]
struct Neon(float32x4_t, float32x4_t);

impl Vector for Neon {
    const LANES: usize = 8;
    // Of 32 registers, 24 hold sums, and 4 hold the two vectors.
    const ROWS: usize = 6;
    type Doubles = NeonDoubles;

    inlined! {
        fn load(from: *const f32) -> Self { Self(vld1q_f32(from), vld1q_f32(from.add(4))) }
        fn store(self, to: *mut f32) {
            vst1q_f32(to, self.0);
            vst1q_f32(to.add(4), self.1);
        }
        fn splat(value: f32) -> Self { Self(vdupq_n_f32(value), vdupq_n_f32(value)) }
        // Prevents the compiler from copying the float to all lanes: FMLA multiplies by one lane, and the load that copies
        // (LD1R) occupies a slot in its pipelines
        // (https://dougallj.github.io/applecpu/measurements/icestorm/LD1R_post_4S.html).
        fn broadcast(from: *const f32) -> Self {
            let mut value = *from;
            #[cfg(not(miri))]
            std::arch::asm!(
                "/* {0:v} */",
                inout(vreg) value,
                options(pure, nomem, nostack, preserves_flags)
            );
            Self::splat(value)
        }
        fn add(self, other: Self) -> Self {
            Self(vaddq_f32(self.0, other.0), vaddq_f32(self.1, other.1))
        }
        fn sub(self, other: Self) -> Self {
            Self(vsubq_f32(self.0, other.0), vsubq_f32(self.1, other.1))
        }
        fn mul(self, other: Self) -> Self {
            Self(vmulq_f32(self.0, other.0), vmulq_f32(self.1, other.1))
        }
        // As at the other levels, a NaN in `self` is ignored.
        fn max(self, other: Self) -> Self {
            Self(vmaxnmq_f32(self.0, other.0), vmaxnmq_f32(self.1, other.1))
        }
        fn mul_add(self, factor: Self, term: Self) -> Self {
            Self(vfmaq_f32(term.0, self.0, factor.0), vfmaq_f32(term.1, self.1, factor.1))
        }
        fn where_positive(self, other: Self) -> Self {
            let positive = |value, sign| {
                let bits = vandq_u32(vreinterpretq_u32_f32(value), vcgtzq_f32(sign));
                vreinterpretq_f32_u32(bits)
            };
            Self(positive(self.0, other.0), positive(self.1, other.1))
        }
        fn total(self) -> f32 {
            let half = vaddq_f32(self.0, self.1);
            vpadds_f32(vadd_f32(vget_low_f32(half), vget_high_f32(half)))
        }
    }
}

#[derive(Clone, Copy)]
struct NeonDoubles(float64x2_t, float64x2_t);

impl Doubles for NeonDoubles {
    const LANES: usize = 4;
    // Three would leave only two registers, and the compiler would spill sums.
    const ROWS: usize = 2;

    inlined! {
        fn load(from: *const f64) -> Self { Self(vld1q_f64(from), vld1q_f64(from.add(2))) }
        fn store(self, to: *mut f64) {
            vst1q_f64(to, self.0);
            vst1q_f64(to.add(2), self.1);
        }
        fn splat(value: f64) -> Self { Self(vdupq_n_f64(value), vdupq_n_f64(value)) }
        fn mul(self, other: Self) -> Self {
            Self(vmulq_f64(self.0, other.0), vmulq_f64(self.1, other.1))
        }
        fn div(self, other: Self) -> Self {
            Self(vdivq_f64(self.0, other.0), vdivq_f64(self.1, other.1))
        }
        fn sqrt(self) -> Self { Self(vsqrtq_f64(self.0), vsqrtq_f64(self.1)) }
        fn less_product(self, a: Self, b: Self) -> Self {
            Self(vfmsq_f64(self.0, a.0, b.0), vfmsq_f64(self.1, a.1, b.1))
        }
    }
}
