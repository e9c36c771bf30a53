//! Seeded random streams that never change between releases.
//!
//! A stream is named by a seed and a list of keys (a frame id, an epoch, a purpose), so a draw does not depend on the number of
//! workers or on the order of work.
//!
//! ```
//! use lsdc_rng::Rng;
//! let mut points = Rng::stream(7, &["kitchen/00012", "points"]);
//! let same = Rng::stream(7, &["kitchen/00012", "points"]).unit();
//! assert_eq!(points.unit(), same);
//! ```
//!
//! All packages of lsdc use it; `lsdc-kernels` and `lsdc-core` are the next above.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng as _, SeedableRng as _};

/// A stream of random numbers (ChaCha8; the draws below are part of its contract).
#[derive(Clone, Debug)]
pub struct Rng(ChaCha8Rng);

impl Rng {
    /// The stream of `seed` named by `keys`.
    pub fn stream(seed: u64, keys: &[&str]) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(hash(keys));
        Self(rng)
    }

    /// Returns a uniform integer in `0..bound` without bias (Lemire 2019); `bound` must not be 0.
    pub fn below(&mut self, bound: u32) -> u32 {
        let threshold = bound.wrapping_neg() % bound.max(1);
        loop {
            let product = u64::from(self.0.next_u32()) * u64::from(bound);
            if product as u32 >= threshold {
                return (product >> 32) as u32;
            }
        }
    }

    /// Returns a uniform number in `[0, 1)` with 24 random bits.
    pub fn unit(&mut self) -> f32 {
        (self.0.next_u32() >> 8) as f32 / (1 << 24) as f32
    }

    /// Returns a uniform number in `[low, high)`.
    pub fn range(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.unit()
    }

    /// Returns true with the given probability.
    pub fn chance(&mut self, probability: f32) -> bool {
        self.unit() < probability
    }

    /// Returns a standard normal number (Box and Muller 1958).
    pub fn normal(&mut self) -> f32 {
        let radius = (-2.0 * (1.0 - f64::from(self.unit())).ln()).sqrt();
        (radius * (std::f64::consts::TAU * f64::from(self.unit())).cos()) as f32
    }

    /// Moves a uniform random sample of `count` items to the front, in random order (partial Fisher-Yates shuffle).
    pub fn choose<T>(&mut self, items: &mut [T], count: usize) {
        for i in 0..count.min(items.len()) {
            let j = i + self.below((items.len() - i) as u32) as usize;
            items.swap(i, j);
        }
    }
}

/// Returns the 64-bit FNV-1a hash of the keys with a separator.
pub fn hash(keys: &[impl AsRef<[u8]>]) -> u64 {
    let mut state = 0xcbf2_9ce4_8422_2325_u64;
    for key in keys {
        for &byte in key.as_ref().iter().chain(&[0xff]) {
            state = (state ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }
    state
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fnv_matches_its_published_vector() {
        // FNV-1a 64 of "foobar" is 0x85944171f73967e8; the separator byte adds one more round.
        let expected = (0x8594_4171_f739_67e8_u64 ^ 0xff).wrapping_mul(0x0100_0000_01b3);
        assert_eq!(hash(&["foobar"]), expected);
        assert_ne!(hash(&["ab", "c"]), hash(&["a", "bc"]));
    }

    #[test]
    fn draws_are_uniform_and_repeatable() {
        let mut rng = Rng::stream(7, &["uniform"]);
        let mut counts = [0_u32; 10];
        for _ in 0..100_000 {
            counts[rng.below(10) as usize] += 1;
        }
        // Chi-squared with 9 degrees of freedom: 27.9 is the 99.9 % point.
        let chi2: f64 = counts
            .iter()
            .map(|&c| (f64::from(c) - 1e4).powi(2) / 1e4)
            .sum();
        assert!(chi2 < 27.9, "chi-squared {chi2}");
        assert_eq!(
            Rng::stream(7, &["a"]).below(1 << 30),
            Rng::stream(7, &["a"]).below(1 << 30)
        );
        assert_ne!(
            Rng::stream(7, &["a"]).below(1 << 30),
            Rng::stream(8, &["a"]).below(1 << 30)
        );
    }

    #[test]
    fn choice_has_no_repeats() {
        let mut items: Vec<u32> = (0..1000).collect();
        Rng::stream(0, &[]).choose(&mut items, 500);
        let mut head = items[..500].to_vec();
        head.sort_unstable();
        head.dedup();
        assert_eq!(head.len(), 500);
    }
}
