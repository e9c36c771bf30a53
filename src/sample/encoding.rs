//! What a pretrained encoder says of training images: computed once, then kept in files.

use super::image_values;
use crate::data::write_atomically;
use crate::error::{Error, Result};
use crate::pretrained::ANYTHING;
use half::f16;
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
    folder: Option<PathBuf>,
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
            folder,
        }
    }

    /// The features of an image, rounded to half precision, in which they are kept.
    ///
    /// # Errors
    /// A file that cannot be written, or an image without pixels.
    pub fn of(&self, rgb: &RgbImage) -> Result<Encoded> {
        let Some(folder) = &self.folder else {
            return Ok(from_halves(self.compute(rgb)?));
        };
        let path = folder.join(format!("{:016x}.f16", self.key(rgb)));
        let (rows, columns) = Encoded::size((rgb.height() as usize, rgb.width() as usize));
        let channels = self.encoder.config().channels();
        if let Some(bytes) = std::fs::read(&path).ok().and_then(unsealed)
            && bytes.len() == 2 * rows * columns * channels
        {
            return Ok(from_halves((bytes, rows, columns)));
        }
        let found = self.compute(rgb)?;
        std::fs::create_dir_all(folder).map_err(|e| Error::write(folder, e))?;
        write_atomically(&path, |out| {
            out.write_all(&found.0)?;
            out.write_all(&hash(&[&found.0]).to_le_bytes())
        })?;
        Ok(from_halves(found))
    }

    /// Half-precision features, rows and columns.
    fn compute(&self, rgb: &RgbImage) -> Result<Halves> {
        let Normalisation {
            mean, deviation, ..
        } = self.normalisation;
        let values = image_values(rgb, mean, deviation);
        let size = (rgb.height() as usize, rgb.width() as usize);
        let found = self.encoder.encode(&values, size)?;
        let halves = found.values.iter().map(|v| f16::from_f32(*v).to_le_bytes());
        Ok((halves.flatten().collect(), found.rows, found.columns))
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

type Halves = (Vec<u8>, usize, usize);

fn from_halves((bytes, rows, columns): Halves) -> Encoded {
    let (pairs, _) = bytes.as_chunks::<2>();
    let values = pairs.iter().map(|pair| f16::from_le_bytes(*pair).to_f32());
    Encoded {
        rows,
        columns,
        values: values.collect(),
    }
}

/// The contents of a file that ends with their hash; nothing if it is damaged.
fn unsealed(mut bytes: Vec<u8>) -> Option<Vec<u8>> {
    let (contents, seal) = bytes.split_last_chunk::<8>()?;
    let sound = hash(&[contents]).to_le_bytes() == *seal;
    bytes.truncate(bytes.len() - 8);
    sound.then_some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::random_encoder;
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
