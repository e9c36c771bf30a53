//! The unit of a file, given or inferred, and whether its depths are plausible in it.

use super::Unit;
use crate::checks::{NumberType, implausible_unit};

/// The unit of a file, and the number type it was inferred from.
#[derive(Clone, Copy, Debug)]
pub(super) struct FileUnit {
    pub(super) unit: Unit,
    guessed_from: Option<NumberType>,
}

impl FileUnit {
    /// Returns the declared unit, or else millimetres for integers and metres for other numbers.
    pub(super) fn new(declared: Option<Unit>, numbers: NumberType) -> Self {
        let default_unit = match numbers {
            NumberType::Integers { .. } => Unit::MILLIMETRE,
            NumberType::Floats | NumberType::Booleans => Unit::METRE,
        };
        Self {
            unit: declared.unwrap_or(default_unit),
            guessed_from: declared.is_none().then_some(numbers),
        }
    }

    /// Whether the unit is a guess. Metres of floats are not, because all their formats are documented to be in metres;
    /// they count as a guess if there is a [warning](Self::warning).
    pub(super) fn is_guessed(self) -> bool {
        self.guessed_from
            .is_some_and(|numbers| numbers != NumberType::Floats)
    }

    /// Returns why the guess may be wrong, given the resulting depths in metres.
    pub(super) fn warning(self, depths: Vec<f32>) -> Option<String> {
        let numbers = self.guessed_from?;
        if depths.is_empty() {
            return None;
        }
        let unit = self.unit;
        match numbers {
            NumberType::Booleans => Some(
                "true and false are taken for depths of 1 and none: is this a mask?".to_owned(),
            ),
            _ if numbers.are_bytes() => Some(format!(
                "integers of 8 bits are taken for {unit}, at most 0.255 m; --depth-unit says otherwise"
            )),
            _ => implausible_unit(unit, depths).map(|warning| warning.to_string()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whether depths in a guessed unit give a warning.
    fn has_warning(numbers: NumberType, depths: &[f32]) -> bool {
        FileUnit::new(None, numbers)
            .warning(depths.to_vec())
            .is_some()
    }

    #[test]
    fn implausible_units_are_doubted() {
        assert!(has_warning(NumberType::unsigned(8), &[0.1, 0.2]));
        assert!(has_warning(NumberType::Booleans, &[1.0, 1.0]));
        assert!(has_warning(NumberType::Floats, &[1785.0, 2900.0, 6042.0]));
        assert!(has_warning(
            NumberType::unsigned(16),
            &[0.002, 0.004, 0.005]
        ));
        assert!(!has_warning(NumberType::Floats, &[1.7, 2.9, 6.0]));
        assert!(!has_warning(NumberType::unsigned(16), &[1.7, 2.9, 6.0]));
        assert!(!has_warning(NumberType::Floats, &[]));
        let declared = FileUnit::new(Some(Unit::METRE), NumberType::Floats);
        assert_eq!(declared.warning(vec![5000.0]), None);
    }
}
