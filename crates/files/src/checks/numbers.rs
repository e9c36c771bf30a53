//! What numbers are stored as.

/// The type of stored numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NumberType {
    /// True or false.
    Booleans,
    /// Integers of so many bits.
    Integers {
        /// Bits of each, with the sign.
        bits: u32,
        /// Whether negative numbers can be stored.
        signed: bool,
    },
    /// Floating-point numbers.
    Floats,
}

impl NumberType {
    /// Unsigned integers of so many bits.
    pub const fn unsigned(bits: u32) -> Self {
        Self::Integers {
            bits,
            signed: false,
        }
    }

    /// Signed integers of so many bits, with the sign.
    pub const fn signed(bits: u32) -> Self {
        Self::Integers { bits, signed: true }
    }

    /// The largest integer of the type; none of floating-point numbers and booleans.
    pub fn largest(self) -> Option<f64> {
        match self {
            Self::Integers { bits, signed } => {
                Some((f64::from(bits - u32::from(signed)).exp2() - 1.0).max(1.0))
            }
            Self::Booleans | Self::Floats => None,
        }
    }

    /// Whether no number is larger than 255.
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
