//! The unit of a file, said or inferred, and whether its depths are plausible in it.

use super::Unit;
use crate::doubts::{Numbers, implausible_unit};

/// The unit of a file, and what it was inferred from.
#[derive(Clone, Copy, Debug)]
pub(super) struct KnownUnit {
    pub(super) unit: Unit,
    guessed_from: Option<Numbers>,
}

impl KnownUnit {
    /// What was said, or else millimetres for integers and metres for other numbers.
    pub(super) fn new(said: Option<Unit>, numbers: Numbers) -> Self {
        let usual = match numbers {
            Numbers::Integers { .. } => Unit::MILLIMETRE,
            Numbers::Floats | Numbers::Booleans => Unit::METRE,
        };
        Self {
            unit: said.unwrap_or(usual),
            guessed_from: said.is_none().then_some(numbers),
        }
    }

    /// Whether the unit is a guess. Metres of floats are none, as every form of them is documented to be in metres; they
    /// become one if there is a [doubt](Self::doubt).
    pub(super) fn is_guessed(self) -> bool {
        self.guessed_from
            .is_some_and(|numbers| numbers != Numbers::Floats)
    }

    /// Why the guess may be wrong, by the depths in metres that it leads to.
    pub(super) fn doubt(self, depths: Vec<f32>) -> Option<String> {
        let numbers = self.guessed_from?;
        if depths.is_empty() {
            return None;
        }
        let unit = self.unit;
        match numbers {
            Numbers::Booleans => Some(
                "true and false are taken for depths of 1 and none: is this a mask?".to_owned(),
            ),
            _ if numbers.are_bytes() => Some(format!(
                "integers of 8 bits are taken for {unit}, at most 0.255 m; --depth-unit says otherwise"
            )),
            _ => implausible_unit(unit, depths).map(|doubt| doubt.to_string()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is doubted of a guess.
    fn doubted(numbers: Numbers, depths: &[f32]) -> bool {
        KnownUnit::new(None, numbers)
            .doubt(depths.to_vec())
            .is_some()
    }

    #[test]
    fn implausible_units_are_doubted() {
        assert!(doubted(Numbers::unsigned(8), &[0.1, 0.2]));
        assert!(doubted(Numbers::Booleans, &[1.0, 1.0]));
        assert!(doubted(Numbers::Floats, &[1785.0, 2900.0, 6042.0]));
        assert!(doubted(Numbers::unsigned(16), &[0.002, 0.004, 0.005]));
        assert!(!doubted(Numbers::Floats, &[1.7, 2.9, 6.0]));
        assert!(!doubted(Numbers::unsigned(16), &[1.7, 2.9, 6.0]));
        assert!(!doubted(Numbers::Floats, &[]));
        let said = KnownUnit::new(Some(Unit::METRE), Numbers::Floats);
        assert_eq!(said.doubt(vec![5000.0]), None);
    }
}
