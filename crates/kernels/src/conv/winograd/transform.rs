//! The one-dimensional transforms of F(4, 3) with the points 0, 1, -1, 2, -2 and infinity, and
//! their adjoints.
//!
//! The safety requirements of all functions are those of `Vector`.

use super::{IN, OUT};
use crate::simd::Vector;

/// Returns one column of a block of rows, for the second transform.
#[inline(always)]
pub(super) fn column<V: Copy, const N: usize, const M: usize>(
    rows: &[[V; M]; N],
    j: usize,
) -> [V; N] {
    std::array::from_fn(
        #[inline(always)]
        |i| rows[i][j],
    )
}

/// Computes G g, a filter's spectrum.
#[inline(always)]
pub(super) unsafe fn filter<V: Vector>([a, b, c]: [V; 3]) -> [V; IN] {
    // SAFETY: as demanded from the caller.
    unsafe {
        let (sixth, twelfth) = (V::splat(-1.0 / 6.0), V::splat(1.0 / 12.0));
        let (sum, twice) = (a.add(c), b.mul(twelfth));
        // a / 24 + c / 6
        let outer = a.mul(V::splat(1.0 / 24.0)).sub(c.mul(sixth));
        [
            a.mul(V::splat(0.25)),
            sum.add(b).mul(sixth),
            sum.sub(b).mul(sixth),
            outer.add(twice),
            outer.sub(twice),
            c,
        ]
    }
}

/// Computes G^T u, the gradient of the filter from that of its spectrum.
#[inline(always)]
pub(super) unsafe fn filter_adjoint<V: Vector>(u: [V; IN]) -> [V; 3] {
    // SAFETY: as demanded from the caller.
    unsafe {
        let (sixth, twelfth) = (V::splat(1.0 / 6.0), V::splat(1.0 / 12.0));
        let (s1, d1) = (u[1].add(u[2]), u[2].sub(u[1]));
        let (s2, d2) = (u[3].add(u[4]), u[3].sub(u[4]));
        [
            s2.mul_add(V::splat(1.0 / 24.0), u[0].mul(V::splat(0.25)))
                .sub(s1.mul(sixth)),
            d2.mul_add(twelfth, d1.mul(sixth)),
            s2.sub(s1).mul_add(sixth, u[5]),
        ]
    }
}

/// Computes B^T d, the spectrum of six inputs.
#[inline(always)]
pub(super) unsafe fn input<V: Vector>(d: [V; IN]) -> [V; IN] {
    // SAFETY: as demanded from the caller.
    unsafe {
        let (two, four) = (V::splat(2.0), V::splat(4.0));
        let (minus4, minus5) = (V::splat(-4.0), V::splat(-5.0));
        let a = d[2].mul_add(minus4, d[4]);
        let b = d[1].mul_add(minus4, d[3]);
        let c = d[4].sub(d[2]);
        let e = d[3].sub(d[1]).mul(two);
        [
            d[0].mul_add(four, d[2].mul_add(minus5, d[4])),
            a.add(b),
            a.sub(b),
            c.add(e),
            c.sub(e),
            d[1].mul_add(four, d[3].mul_add(minus5, d[5])),
        ]
    }
}

/// Computes A^T m, four outputs from six products.
#[inline(always)]
pub(super) unsafe fn output<V: Vector>(m: [V; IN]) -> [V; OUT] {
    // SAFETY: as demanded from the caller.
    unsafe {
        let (two, four, eight) = (V::splat(2.0), V::splat(4.0), V::splat(8.0));
        let (s1, d1) = (m[1].add(m[2]), m[1].sub(m[2]));
        let (s2, d2) = (m[3].add(m[4]), m[3].sub(m[4]));
        [
            m[0].add(s1.add(s2)),
            d2.mul_add(two, d1),
            s2.mul_add(four, s1),
            m[5].add(d2.mul_add(eight, d1)),
        ]
    }
}

/// Computes A y, the gradient of six products from that of four outputs.
#[inline(always)]
pub(super) unsafe fn output_adjoint<V: Vector>(y: [V; OUT]) -> [V; IN] {
    // SAFETY: as demanded from the caller.
    unsafe {
        let (two, four) = (V::splat(2.0), V::splat(4.0));
        let (even, odd) = (y[0].add(y[2]), y[1].add(y[3]));
        let even4 = y[2].mul_add(four, y[0]);
        let odd2 = y[3].mul_add(four, y[1]).mul(two);
        [
            y[0],
            even.add(odd),
            even.sub(odd),
            even4.add(odd2),
            even4.sub(odd2),
            y[3],
        ]
    }
}
