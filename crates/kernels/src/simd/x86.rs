//! The vectors of x86-64.

use super::{Doubles, Kernel, Vector};
#[allow(clippy::wildcard_imports)]
use std::arch::x86_64::*;

/// # Safety
/// The processor has AVX-512F; the kernel's own demands.
#[target_feature(enable = "avx512f")]
pub(super) unsafe fn avx512<K: Kernel>(kernel: K) -> K::Output {
    // SAFETY: this function is compiled for the vectors' instructions.
    unsafe { kernel.run::<__m512>() }
}

/// # Safety
/// The processor has AVX2 and FMA; the kernel's own demands.
#[target_feature(enable = "avx2,fma")]
pub(super) unsafe fn avx2<K: Kernel>(kernel: K) -> K::Output {
    // SAFETY: this function is compiled for the vectors' instructions.
    unsafe { kernel.run::<__m256>() }
}

/// Implements `Vector` by one intrinsic per function.
macro_rules! vector {
    (
        $type:ty, lanes $lanes:literal, rows $rows:literal, doubles $doubles:ty,
        $load:ident $store:ident $splat:ident $add:ident $sub:ident $mul:ident $max:ident $fma:ident
        total($sum:ident) $total:expr,
        where_positive($a:ident, $b:ident) $positive:expr
    ) => {
        // SAFETY (of every function): as demanded from the caller.
        impl Vector for $type {
            const LANES: usize = $lanes;
            const ROWS: usize = $rows;
            type Doubles = $doubles;

            #[inline(always)]
            unsafe fn load(from: *const f32) -> Self {
                unsafe { $load(from) }
            }

            #[inline(always)]
            unsafe fn store(self, to: *mut f32) {
                unsafe { $store(to, self) }
            }

            #[inline(always)]
            unsafe fn splat(value: f32) -> Self {
                unsafe { $splat(value) }
            }

            #[inline(always)]
            unsafe fn add(self, other: Self) -> Self {
                unsafe { $add(self, other) }
            }

            #[inline(always)]
            unsafe fn sub(self, other: Self) -> Self {
                unsafe { $sub(self, other) }
            }

            #[inline(always)]
            unsafe fn mul(self, other: Self) -> Self {
                unsafe { $mul(self, other) }
            }

            #[inline(always)]
            unsafe fn max(self, other: Self) -> Self {
                unsafe { $max(self, other) }
            }

            #[inline(always)]
            unsafe fn mul_add(self, factor: Self, term: Self) -> Self {
                unsafe { $fma(self, factor, term) }
            }

            #[inline(always)]
            unsafe fn where_positive(self, other: Self) -> Self {
                let ($a, $b) = (self, other);
                unsafe { $positive }
            }

            #[inline(always)]
            unsafe fn total(self) -> f32 {
                let $sum = self;
                unsafe { $total }
            }
        }
    };
}

vector!(
    __m512, lanes 16, rows 14, doubles __m512d,
    _mm512_loadu_ps _mm512_storeu_ps _mm512_set1_ps _mm512_add_ps _mm512_sub_ps _mm512_mul_ps
    _mm512_max_ps _mm512_fmadd_ps
    total(sum) _mm512_reduce_add_ps(sum),
    where_positive(a, b) {
        _mm512_maskz_mov_ps(_mm512_cmp_ps_mask::<_CMP_GT_OQ>(b, _mm512_setzero_ps()), a)
    }
);
vector!(
    __m256, lanes 8, rows 6, doubles __m256d,
    _mm256_loadu_ps _mm256_storeu_ps _mm256_set1_ps _mm256_add_ps _mm256_sub_ps _mm256_mul_ps
    _mm256_max_ps _mm256_fmadd_ps
    total(sum) {
        let half = _mm_add_ps(_mm256_castps256_ps128(sum), _mm256_extractf128_ps::<1>(sum));
        let pair = _mm_add_ps(half, _mm_movehl_ps(half, half));
        _mm_cvtss_f32(_mm_add_ss(pair, _mm_movehdup_ps(pair)))
    },
    where_positive(a, b) {
        _mm256_and_ps(_mm256_cmp_ps::<_CMP_GT_OQ>(b, _mm256_setzero_ps()), a)
    }
);

/// Implements `Doubles` by one intrinsic per function.
macro_rules! doubles {
    (
        $type:ty, lanes $lanes:literal,
        $load:ident $store:ident $splat:ident $mul:ident $div:ident $sqrt:ident $fnma:ident
    ) => {
        // SAFETY (of every function): as demanded from the caller.
        impl Doubles for $type {
            const LANES: usize = $lanes;

            #[inline(always)]
            unsafe fn load(from: *const f64) -> Self {
                unsafe { $load(from) }
            }

            #[inline(always)]
            unsafe fn store(self, to: *mut f64) {
                unsafe { $store(to, self) }
            }

            #[inline(always)]
            unsafe fn splat(value: f64) -> Self {
                unsafe { $splat(value) }
            }

            #[inline(always)]
            unsafe fn mul(self, other: Self) -> Self {
                unsafe { $mul(self, other) }
            }

            #[inline(always)]
            unsafe fn div(self, other: Self) -> Self {
                unsafe { $div(self, other) }
            }

            #[inline(always)]
            unsafe fn sqrt(self) -> Self {
                unsafe { $sqrt(self) }
            }

            #[inline(always)]
            unsafe fn less_product(self, a: Self, b: Self) -> Self {
                unsafe { $fnma(a, b, self) }
            }
        }
    };
}

doubles!(
    __m512d, lanes 8,
    _mm512_loadu_pd _mm512_storeu_pd _mm512_set1_pd _mm512_mul_pd _mm512_div_pd _mm512_sqrt_pd
    _mm512_fnmadd_pd
);
doubles!(
    __m256d, lanes 4,
    _mm256_loadu_pd _mm256_storeu_pd _mm256_set1_pd _mm256_mul_pd _mm256_div_pd _mm256_sqrt_pd
    _mm256_fnmadd_pd
);
