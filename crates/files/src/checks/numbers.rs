//! Types of stored numbers.

/// The type of stored numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NumberType {
    /// True or false.
    Booleans,
    /// Integers.
    Integers {
        /// Number of bits, including the sign.
        bits: u32,
        /// Whether negative numbers can be stored.
        signed: bool,
    },
    /// Floating-point numbers.
    Floats,
}

impl NumberType {
    /// Unsigned integers of this many bits.
    pub const fn unsigned(bits: u32) -> Self {
        Self::Integers {
            bits,
            signed: false,
        }
    }

    /// Signed integers of this many bits, including the sign.
    pub const fn signed(bits: u32) -> Self {
        Self::Integers { bits, signed: true }
    }

    /// Returns the largest integer of the type; `None` for floating-point numbers and booleans.
    pub fn largest(self) -> Option<f64> {
        match self {
            Self::Integers { bits, signed } => {
                Some((f64::from(bits - u32::from(signed)).exp2() - 1.0).max(1.0))
            }
            Self::Booleans | Self::Floats => None,
        }
    }

    /// Whether all numbers are at most 255.
    pub fn are_bytes(self) -> bool {
        matches!(self, Self::Integers { bits, .. } if bits <= 8)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_largest_number_follows_from_bits_and_sign() {
        assert_eq!(NumberType::unsigned(8).largest(), Some(255.0));
        assert_eq!(NumberType::unsigned(16).largest(), Some(65535.0));
        assert_eq!(NumberType::signed(16).largest(), Some(32767.0));
        assert_eq!(NumberType::unsigned(32).largest(), Some(4_294_967_295.0));
        assert_eq!(NumberType::Floats.largest(), None);
    }
}
