//! What a pretrained encoder says of training images: computed once, then kept in files.

use super::{Halves, image_values};
use crate::error::Result;
use crate::pretrained::ANYTHING;
use image::RgbImage;
use lsdc_core::network::{Encoded, Encoder};
use lsdc_core::weights::Normalisation;
use lsdc_rng::hash;
use std::path::PathBuf;
use std::sync::Arc;

/// Encodes training images.
#[derive(Clone, Debug)]
pub struct Encoding {
    encoder: Arc<Encoder>,
    normalisation: Normalisation,
    kept: Halves,
}

impl Encoding {
    /// Keeps what is found in files of `folder`, if one is given: 2.4 MB for an image of aspect 4:3.
    pub fn new(
        encoder: Arc<Encoder>,
        normalisation: Normalisation,
        folder: Option<PathBuf>,
    ) -> Self {
        Self {
            encoder,
            normalisation,
            kept: Halves::new(folder),
        }
    }

    /// The features of an image, rounded to half precision, in which they are kept.
    ///
    /// # Errors
    /// A file that cannot be written, or an image without pixels.
    pub fn of(&self, rgb: &RgbImage) -> Result<Encoded> {
        let size = (rgb.height() as usize, rgb.width() as usize);
        let (rows, columns) = Encoded::size(size);
        let length = rows * columns * self.encoder.config().channels();
        let values = self.kept.get(self.key(rgb), length, || {
            let Normalisation {
                mean, deviation, ..
            } = self.normalisation;
            let values = image_values(rgb, mean, deviation);
            Ok(self.encoder.encode(&values, size)?.values)
        })?;
        Ok(Encoded {
            rows,
            columns,
            values,
        })
    }

    /// A number that changes with everything that the features depend on.
    fn key(&self, rgb: &RgbImage) -> u64 {
        let Normalisation {
            mean, deviation, ..
        } = self.normalisation;
        let colours = mean.iter().chain(&deviation).flat_map(|v| v.to_le_bytes());
        let colours: Vec<u8> = colours.collect();
        hash(&[
            ANYTHING.identity.as_bytes(),
            &colours,
            &rgb.width().to_le_bytes(),
            rgb.as_raw(),
        ])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::random_encoder;
    use half::f16;
    use image::Rgb;

    #[test]
    fn features_are_kept_in_files_and_damaged_files_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let encoding = |folder: Option<PathBuf>| {
            Encoding::new(random_encoder(), Normalisation::default(), folder)
        };
        let kept = encoding(Some(folder.path().join("features")));
        let rgb = RgbImage::from_fn(40, 30, |x, y| Rgb([(x * 6) as u8, (y * 8) as u8, 90]));
        let files = || -> Vec<PathBuf> {
            let entries = std::fs::read_dir(folder.path().join("features")).unwrap();
            entries.map(|entry| entry.unwrap().path()).collect()
        };
        let plain = encoding(None).of(&rgb).unwrap();
        assert_eq!(kept.of(&rgb).unwrap(), plain);
        // Read, not computed: another sound file in its place is believed.
        let [file] = &files()[..] else {
            panic!("{:?}", files());
        };
        let mut bytes = std::fs::read(file).unwrap();
        let contents = bytes.len() - 8;
        bytes[..2].copy_from_slice(&f16::from_f32(7.0).to_le_bytes());
        let seal = hash(&[&bytes[..contents]]).to_le_bytes();
        bytes[contents..].copy_from_slice(&seal);
        std::fs::write(file, &bytes).unwrap();
        assert_eq!(kept.of(&rgb).unwrap().values[0], 7.0);
        bytes[4] ^= 1;
        std::fs::write(file, &bytes).unwrap();
        assert_eq!(kept.of(&rgb).unwrap(), plain);
        std::fs::write(file, [1, 2]).unwrap();
        assert_eq!(kept.of(&rgb).unwrap(), plain);
        // Another image has another file.
        let other = RgbImage::from_fn(40, 30, |x, _| Rgb([x as u8; 3]));
        assert_ne!(kept.of(&other).unwrap(), plain);
        assert_eq!(files().len(), 2);
    }
}
