//! Pixel values as stored in a file, before they are converted to depths.

use crate::checks::{NumberFormat, NumberType, Warning, is_rotated, leave_out_marks, rotate_back};
use crate::error::Result;
use crate::file_unit::FileUnit;
use crate::{DepthMap, Orientation, Unit};

/// Values in rows, with metadata of the file.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Raster {
    pub(crate) rows: usize,
    pub(crate) columns: usize,
    /// Values, row by row.
    pub(crate) values: Vec<f32>,
    /// Stored type.
    pub(crate) numbers: NumberType,
    /// Value that the file declares as no measurement.
    pub(crate) declared: Option<f64>,
    /// Whether only 0 marks missing measurements, as in files that this program wrote.
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

    /// Turns a raster upright that is stored in one of the eight orientations of EXIF and TIFF.
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

    /// Converts to a map in metres: value x `metres`. Values that mark missing measurements are left out.
    pub(crate) fn depth(mut self, metres: f64) -> Result<(DepthMap, Vec<Warning>)> {
        self.leave_out_marks(metres);
        Ok((self.scaled(metres)?, self.warnings))
    }

    /// [`Self::depth`] in a unit that the file does not declare. If the unit is a guess, the bits of SUN RGB-D are rotated
    /// back.
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

    /// Multiplies all values by `metres`, without leaving out marks.
    pub(crate) fn scaled(&mut self, metres: f64) -> Result<DepthMap> {
        let mut values = std::mem::take(&mut self.values);
        for value in &mut values {
            *value = (f64::from(*value) * metres) as f32;
        }
        Ok(DepthMap::new(self.columns, self.rows, values)?)
    }
}

/// Returns the median of the positive values; 0 if there are none.
fn median(values: &[f32]) -> f32 {
    let mut positive: Vec<f32> = values.iter().copied().filter(|v| *v > 0.0).collect();
    if positive.is_empty() {
        return 0.0;
    }
    let middle = positive.len() / 2;
    *positive.select_nth_unstable_by(middle, f32::total_cmp).1
}
