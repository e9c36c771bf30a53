//! Numbers of pixels as a file stores them, before they become depths.

use crate::checks::{NumberFormat, NumberType, Warning, is_rotated, leave_out_marks, rotate_back};
use crate::error::Result;
use crate::file_unit::FileUnit;
use crate::{DepthMap, Orientation, Unit};

/// Numbers in rows, and what the file says of them.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Raster {
    pub(crate) rows: usize,
    pub(crate) columns: usize,
    /// Row by row.
    pub(crate) values: Vec<f32>,
    /// What they are stored as.
    pub(crate) numbers: NumberType,
    /// The value that the file declares as no measurement.
    pub(crate) declared: Option<f64>,
    /// Whether 0 alone marks no measurement, as in files that this program wrote.
    pub(crate) plain: bool,
    pub(crate) warnings: Vec<Warning>,
}

impl Raster {
    pub(crate) fn new(
        (columns, rows): (usize, usize),
        values: Vec<f32>,
        numbers: NumberType,
    ) -> Self {
        Self {
            rows,
            columns,
            values,
            numbers,
            declared: None,
            plain: false,
            warnings: Vec::new(),
        }
    }

    /// The numbers of a file whose rows and columns are stored in one of the eight orientations of EXIF and TIFF.
    pub(crate) fn upright(mut self, exif: u8) -> Self {
        let orientation = Orientation::new((self.columns, self.rows), exif);
        if orientation.is_upright() {
            return self;
        }
        let (columns, rows) = orientation.upright();
        let stored = std::mem::replace(&mut self.values, vec![0.0; columns * rows]);
        for (index, value) in stored.into_iter().enumerate() {
            let (u, v) = (index % self.columns, index / self.columns);
            let [u, v] = orientation.turned([u as f64, v as f64]);
            self.values[v as usize * columns + u as usize] = value;
        }
        Self {
            rows,
            columns,
            ..self
        }
    }

    /// The map in metres: number x `metres`. Marks of no measurement are left out.
    pub(crate) fn depth(mut self, metres: f64) -> Result<(DepthMap, Vec<Warning>)> {
        self.leave_out_marks(metres);
        Ok((self.scaled(metres)?, self.warnings))
    }

    /// As [`Self::depth`] in a unit that the file does not declare. If it is a guess, the bits of SUN RGB-D are
    /// rotated back.
    pub(crate) fn depth_in(mut self, known: FileUnit) -> Result<(DepthMap, Vec<Warning>)> {
        /// Half a metre in the numbers of SUN RGB-D.
        const ROOM: f32 = 4000.0;
        let metres = known.unit.metres();
        self.leave_out_marks(metres);
        let unsure = known.is_guessed() || known.unit == Unit::MILLIMETRE;
        if unsure && self.numbers == NumberType::unsigned(16) && is_rotated(&self.values) {
            if known.is_guessed() && median(&self.values) >= ROOM {
                rotate_back(&mut self.values);
                self.warnings.push(Warning::Rotated);
            } else {
                self.warnings.push(Warning::MaybeRotated);
            }
        }
        Ok((self.scaled(metres)?, self.warnings))
    }

    fn leave_out_marks(&mut self, metres: f64) {
        if self.plain {
            return;
        }
        let known = NumberFormat {
            numbers: self.numbers,
            metres,
            declared: self.declared,
        };
        let found = leave_out_marks(&mut self.values, &known);
        self.warnings.extend(found);
    }

    /// The numbers times `metres`, whatever they mark.
    pub(crate) fn scaled(&mut self, metres: f64) -> Result<DepthMap> {
        let mut values = std::mem::take(&mut self.values);
        for value in &mut values {
            *value = (f64::from(*value) * metres) as f32;
        }
        Ok(DepthMap::new(self.columns, self.rows, values)?)
    }
}

/// The median of the positive values; 0 of none.
fn median(values: &[f32]) -> f32 {
    let mut positive: Vec<f32> = values.iter().copied().filter(|v| *v > 0.0).collect();
    if positive.is_empty() {
        return 0.0;
    }
    let middle = positive.len() / 2;
    *positive.select_nth_unstable_by(middle, f32::total_cmp).1
}
