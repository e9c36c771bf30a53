//! Features of a pretrained encoder for training images, computed once and cached in files.

use super::{F16Cache, image_values};
use image::RgbImage;
use lsdc_core::network::{Encoder, EncoderSide, FeatureMap};
use lsdc_core::weights::Normalisation;
use lsdc_files::error::Result;
use lsdc_rng::hash;
use lsdc_weights::ANYTHING;
use std::path::PathBuf;
use std::sync::Arc;

/// An encoder of training images, with a cache.
#[derive(Clone, Debug)]
pub struct Encoding {
    encoder: Arc<Encoder>,
    normalisation: Normalisation,
    cache: F16Cache,
}

impl Encoding {
    /// Creates an encoder that caches features in files of `folder`, if given: 2.4 MB for an image of aspect 4:3.
    pub fn new(
        encoder: Arc<Encoder>,
        normalisation: Normalisation,
        folder: Option<PathBuf>,
    ) -> Self {
        Self {
            encoder,
            normalisation,
            cache: F16Cache::new(folder),
        }
    }

    /// Encodes an image, or reads its cached features. Features are rounded to half precision, as in the cache.
    ///
    /// # Errors
    /// A file cannot be written, or the image has no pixels.
    pub fn of(&self, rgb: &RgbImage) -> Result<FeatureMap> {
        let size = (rgb.height() as usize, rgb.width() as usize);
        let (rows, columns) = EncoderSide::default().patches(size);
        let length = rows * columns * self.encoder.config().channels();
        let values = self.cache.get(self.key(rgb), length, || {
            let image = image_values(rgb, self.normalisation);
            Ok(self
                .encoder
                .encode(&image, size, EncoderSide::default())?
                .values)
        })?;
        Ok(FeatureMap {
            rows,
            columns,
            values,
        })
    }

    /// Returns a key that depends on everything that the features depend on.
    fn key(&self, rgb: &RgbImage) -> u64 {
        let Normalisation {
            mean, deviation, ..
        } = self.normalisation;
        let colours = mean.iter().chain(&deviation).flat_map(|v| v.to_le_bytes());
        let colours: Vec<u8> = colours.collect();
        let width = rgb.width().to_le_bytes();
        hash(&[ANYTHING.identity.as_bytes(), &colours, &width, rgb.as_raw()])
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
        let cached = encoding(Some(folder.path().join("features")));
        let rgb = RgbImage::from_fn(40, 30, |x, y| Rgb([(x * 6) as u8, (y * 8) as u8, 90]));
        let files = || -> Vec<PathBuf> {
            let entries = std::fs::read_dir(folder.path().join("features")).unwrap();
            entries.map(|entry| entry.unwrap().path()).collect()
        };
        let plain = encoding(None).of(&rgb).unwrap();
        assert_eq!(cached.of(&rgb).unwrap(), plain);
        // The file is read, not recomputed: another valid file in its place is accepted.
        let [file] = &files()[..] else {
            panic!("{:?}", files());
        };
        let mut bytes = std::fs::read(file).unwrap();
        let contents = bytes.len() - 8;
        bytes[..2].copy_from_slice(&f16::from_f32(7.0).to_le_bytes());
        let seal = hash(&[&bytes[..contents]]).to_le_bytes();
        bytes[contents..].copy_from_slice(&seal);
        std::fs::write(file, &bytes).unwrap();
        assert_eq!(cached.of(&rgb).unwrap().values[0], 7.0);
        bytes[4] ^= 1;
        std::fs::write(file, &bytes).unwrap();
        assert_eq!(cached.of(&rgb).unwrap(), plain);
        std::fs::write(file, [1, 2]).unwrap();
        assert_eq!(cached.of(&rgb).unwrap(), plain);
        // Another image has another file.
        let other = RgbImage::from_fn(40, 30, |x, _| Rgb([x as u8; 3]));
        assert_ne!(cached.of(&other).unwrap(), plain);
        assert_eq!(files().len(), 2);
    }
}
