//! Features of a pretrained encoder for training images: computed once, then cached in files.

use super::{F16Cache, image_values};
use image::RgbImage;
use lsdc_core::network::{Encoder, EncoderConfig, FeatureMap};
use lsdc_core::weights::Normalisation;
use lsdc_files::error::Result;
use lsdc_rng::hash;
use lsdc_weights::ANYTHING;
use std::path::PathBuf;
use std::sync::Arc;

/// Encodes training images.
#[derive(Clone, Debug)]
pub struct Encoding {
    encoder: Arc<Encoder>,
    normalisation: Normalisation,
    cache: F16Cache,
    /// The first block that is trained, if any is.
    trained: Option<usize>,
}

/// The output of an encoder for an image, rounded to half precision, in which it is cached.
#[derive(Clone, Debug, PartialEq)]
pub struct EncoderOutput {
    /// The features.
    pub features: FeatureMap,
    /// The tokens that enter the first block that is trained, `[1 + rows x columns, width]`; nothing if none is.
    pub tokens: Option<Vec<f32>>,
}

impl Encoding {
    /// Caches features in files of `folder`, if one is given: 2.4 MB for an image of aspect 4:3.
    pub fn new(
        encoder: Arc<Encoder>,
        normalisation: Normalisation,
        folder: Option<PathBuf>,
    ) -> Self {
        Self {
            encoder,
            normalisation,
            cache: F16Cache::new(folder),
            trained: None,
        }
    }

    /// Returns the tokens that enter a block too, and caches them in files of their own: another 0.6 MB.
    #[must_use]
    pub fn tokens_before(self, block: Option<usize>) -> Self {
        Self {
            trained: block,
            ..self
        }
    }

    /// Encodes an image, or reads what was cached of it.
    ///
    /// # Errors
    /// A file that cannot be written, an image without pixels, or a block that the encoder does not have.
    pub fn of(&self, rgb: &RgbImage) -> Result<EncoderOutput> {
        let size = (rgb.height() as usize, rgb.width() as usize);
        let (rows, columns) = FeatureMap::size(size);
        let EncoderConfig { width, .. } = *self.encoder.config();
        let image = || image_values(rgb, self.normalisation);
        let length = rows * columns * self.encoder.config().channels();
        let values = self.cache.get(self.key(rgb, &[]), length, || {
            Ok(self.encoder.encode(&image(), size)?.values)
        })?;
        let tokens = |block: usize| {
            // Of another kind than the features, so under another key.
            let key = self.key(rgb, format!("entering block {block}").as_bytes());
            self.cache.get(key, (1 + rows * columns) * width, || {
                Ok(self.encoder.encode_before(&image(), size, block)?)
            })
        };
        Ok(EncoderOutput {
            features: FeatureMap {
                rows,
                columns,
                values,
            },
            tokens: self.trained.map(tokens).transpose()?,
        })
    }

    /// A number that changes with everything that the features depend on, and with their kind.
    fn key(&self, rgb: &RgbImage, kind: &[u8]) -> u64 {
        let Normalisation {
            mean, deviation, ..
        } = self.normalisation;
        let colours = mean.iter().chain(&deviation).flat_map(|v| v.to_le_bytes());
        let colours: Vec<u8> = colours.collect();
        let width = rgb.width().to_le_bytes();
        let identity = ANYTHING.identity.as_bytes();
        let parts = [identity, &colours, &width, rgb.as_raw(), kind];
        // Features are of no kind: files of earlier versions hold them alone.
        let count = if kind.is_empty() { 4 } else { 5 };
        hash(&parts[..count])
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
        assert_eq!(cached.of(&rgb).unwrap().features.values[0], 7.0);
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

    #[test]
    fn tokens_are_kept_beside_the_features() {
        let folder = tempfile::tempdir().unwrap();
        let encoding = |block: Option<usize>| {
            let folder = Some(folder.path().to_owned());
            Encoding::new(random_encoder(), Normalisation::default(), folder).tokens_before(block)
        };
        let rgb = RgbImage::from_fn(40, 30, |x, y| Rgb([(x * 6) as u8, (y * 8) as u8, 90]));
        let files = || std::fs::read_dir(folder.path()).unwrap().count();
        let plain = encoding(None).of(&rgb).unwrap();
        assert_eq!((plain.tokens.as_ref(), files()), (None, 1));
        // The features are those that were kept without them.
        let second = encoding(Some(2)).of(&rgb).unwrap();
        assert_eq!((&second.features, files()), (&plain.features, 2));
        assert_eq!(encoding(Some(2)).of(&rgb).unwrap(), second);
        // They say what enters the block, but for rounding.
        let values = image_values(&rgb, Normalisation::default());
        let exact = random_encoder()
            .encode_before(&values, (30, 40), 2)
            .unwrap();
        let tokens = second.tokens.unwrap();
        assert_eq!(tokens.len(), exact.len());
        for (found, exact) in tokens.iter().zip(&exact) {
            assert!((found - exact).abs() < 1e-3 * exact.abs() + 1e-4);
        }
        // Those of another block are others.
        let third = encoding(Some(3)).of(&rgb).unwrap();
        assert_eq!(files(), 3);
        assert_ne!(third.tokens, Some(tokens));
        assert!(encoding(Some(4)).of(&rgb).is_err());
    }
}
