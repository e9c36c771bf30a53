//! A cache of arrays that are slow to compute: files in half precision, each with a key of everything that it depends on.
//! Several processes may fill a folder together.

use half::f16;
use lsdc_eval::data::write_atomically;
use lsdc_files::error::{Error, Result};
use lsdc_rng::hash;
use std::path::PathBuf;

/// A folder of cached arrays; without a folder, nothing is cached.
#[derive(Clone, Debug)]
pub struct F16Cache {
    folder: Option<PathBuf>,
}

impl F16Cache {
    /// Caches arrays in files of `folder`, if given.
    pub fn new(folder: Option<PathBuf>) -> Self {
        Self { folder }
    }

    /// Returns the `length` values cached under `key`, or computes and caches them. Both are rounded to half precision. Damaged
    /// files are replaced.
    ///
    /// # Errors
    /// The errors of `compute`, or a file cannot be written.
    pub fn get(
        &self,
        key: u64,
        length: usize,
        compute: impl FnOnce() -> Result<Vec<f32>>,
    ) -> Result<Vec<f32>> {
        let compute = || -> Result<Vec<u8>> {
            let halves = compute()?
                .into_iter()
                .map(|v| f16::from_f32(v).to_le_bytes());
            Ok(halves.flatten().collect())
        };
        let Some(folder) = &self.folder else {
            return Ok(numbers(&compute()?));
        };
        let path = folder.join(format!("{key:016x}.f16"));
        if let Some(bytes) = std::fs::read(&path).ok().and_then(unsealed)
            && bytes.len() == 2 * length
        {
            return Ok(numbers(&bytes));
        }
        let bytes = compute()?;
        std::fs::create_dir_all(folder).map_err(|e| Error::write(folder, e))?;
        write_atomically(&path, |out| {
            out.write_all(&bytes)?;
            out.write_all(&hash(&[&bytes]).to_le_bytes())
        })?;
        Ok(numbers(&bytes))
    }
}

fn numbers(bytes: &[u8]) -> Vec<f32> {
    let (pairs, _) = bytes.as_chunks::<2>();
    let values = pairs.iter().map(|pair| f16::from_le_bytes(*pair).to_f32());
    values.collect()
}

/// Returns the contents of a file that ends with their hash; `None` if it is damaged.
fn unsealed(mut bytes: Vec<u8>) -> Option<Vec<u8>> {
    let (contents, seal) = bytes.split_last_chunk::<8>()?;
    let sound = hash(&[contents]).to_le_bytes() == *seal;
    bytes.truncate(bytes.len() - 8);
    sound.then_some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_kept_in_files_and_damaged_files_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let cache = F16Cache::new(Some(folder.path().join("numbers")));
        // Rounded to 11 bits, whether computed or read.
        let get = |value: f32| cache.get(7, 2, || Ok(vec![value, 0.1])).unwrap();
        assert_eq!(get(2049.0), [2048.0, 0.099_975_586]);
        assert_eq!(get(5.0), [2048.0, 0.099_975_586]);
        let file = folder.path().join("numbers/0000000000000007.f16");
        let mut bytes = std::fs::read(&file).unwrap();
        bytes[1] ^= 1;
        std::fs::write(&file, &bytes).unwrap();
        assert_eq!(get(5.0)[0], 5.0);
        std::fs::write(&file, [1, 2]).unwrap();
        assert_eq!(get(6.0)[0], 6.0);
        // The same key with another length.
        assert_eq!(cache.get(7, 1, || Ok(vec![8.0])).unwrap(), [8.0]);
        assert_eq!(cache.get(8, 1, || Ok(vec![9.0])).unwrap(), [9.0]);
        assert_eq!(
            F16Cache::new(None).get(8, 1, || Ok(vec![3.0])).unwrap(),
            [3.0]
        );
        let failed = cache.get(9, 1, || Err(Error::config("no")));
        assert!(failed.is_err());
    }
}
