//! Vectors for x86-64.

use super::{Doubles, Kernel, Vector};
#[allow(clippy::wildcard_imports)]
use std::arch::x86_64::*;

/// # Safety
/// The processor must have AVX-512F, and the kernel's requirements must be met.
#[target_feature(enable = "avx512f")]
pub(super) unsafe fn avx512<K: Kernel>(kernel: K) -> K::Output {
    // SAFETY: this function is compiled for the vectors' instructions.
    unsafe { kernel.run::<__m512>() }
}

/// # Safety
/// The processor must have AVX2 and FMA, and the kernel's requirements must be met.
#[target_feature(enable = "avx2,fma")]
pub(super) unsafe fn avx2<K: Kernel>(kernel: K) -> K::Output {
    // SAFETY: this function is compiled for the vectors' instructions.
    unsafe { kernel.run::<__m256>() }
}

impl Vector for __m512 {
    const LANES: usize = 16;
    const ROWS: usize = 14;
    type Doubles = __m512d;

    inlined! {
        fn load(from: *const f32) -> Self { _mm512_loadu_ps(from) }
        fn store(self, to: *mut f32) { _mm512_storeu_ps(to, self); }
        fn splat(value: f32) -> Self { _mm512_set1_ps(value) }
        fn add(self, other: Self) -> Self { _mm512_add_ps(self, other) }
        fn sub(self, other: Self) -> Self { _mm512_sub_ps(self, other) }
        fn mul(self, other: Self) -> Self { _mm512_mul_ps(self, other) }
        fn max(self, other: Self) -> Self { _mm512_max_ps(self, other) }
        fn mul_add(self, factor: Self, term: Self) -> Self { _mm512_fmadd_ps(self, factor, term) }
        fn where_positive(self, other: Self) -> Self {
            let positive = _mm512_cmp_ps_mask::<_CMP_GT_OQ>(other, _mm512_setzero_ps());
            _mm512_maskz_mov_ps(positive, self)
        }
        fn total(self) -> f32 { _mm512_reduce_add_ps(self) }
    }
}

impl Vector for __m256 {
    const LANES: usize = 8;
    const ROWS: usize = 6;
    type Doubles = __m256d;

    inlined! {
        fn load(from: *const f32) -> Self { _mm256_loadu_ps(from) }
        fn store(self, to: *mut f32) { _mm256_storeu_ps(to, self); }
        fn splat(value: f32) -> Self { _mm256_set1_ps(value) }
        fn add(self, other: Self) -> Self { _mm256_add_ps(self, other) }
        fn sub(self, other: Self) -> Self { _mm256_sub_ps(self, other) }
        fn mul(self, other: Self) -> Self { _mm256_mul_ps(self, other) }
        fn max(self, other: Self) -> Self { _mm256_max_ps(self, other) }
        fn mul_add(self, factor: Self, term: Self) -> Self { _mm256_fmadd_ps(self, factor, term) }
        fn where_positive(self, other: Self) -> Self {
            let positive = _mm256_cmp_ps::<_CMP_GT_OQ>(other, _mm256_setzero_ps());
            _mm256_and_ps(positive, self)
        }
        fn total(self) -> f32 {
            let half = _mm_add_ps(_mm256_castps256_ps128(self), _mm256_extractf128_ps::<1>(self));
            let pair = _mm_add_ps(half, _mm_movehl_ps(half, half));
            _mm_cvtss_f32(_mm_add_ss(pair, _mm_movehdup_ps(pair)))
        }
    }
}

impl Doubles for __m512d {
    const LANES: usize = 8;

    inlined! {
        fn load(from: *const f64) -> Self { _mm512_loadu_pd(from) }
        fn store(self, to: *mut f64) { _mm512_storeu_pd(to, self); }
        fn splat(value: f64) -> Self { _mm512_set1_pd(value) }
        fn mul(self, other: Self) -> Self { _mm512_mul_pd(self, other) }
        fn div(self, other: Self) -> Self { _mm512_div_pd(self, other) }
        fn sqrt(self) -> Self { _mm512_sqrt_pd(self) }
        fn less_product(self, a: Self, b: Self) -> Self { _mm512_fnmadd_pd(a, b, self) }
    }
}

impl Doubles for __m256d {
    const LANES: usize = 4;

    inlined! {
        fn load(from: *const f64) -> Self { _mm256_loadu_pd(from) }
        fn store(self, to: *mut f64) { _mm256_storeu_pd(to, self); }
        fn splat(value: f64) -> Self { _mm256_set1_pd(value) }
        fn mul(self, other: Self) -> Self { _mm256_mul_pd(self, other) }
        fn div(self, other: Self) -> Self { _mm256_div_pd(self, other) }
        fn sqrt(self) -> Self { _mm256_sqrt_pd(self) }
        fn less_product(self, a: Self, b: Self) -> Self { _mm256_fnmadd_pd(a, b, self) }
    }
}
