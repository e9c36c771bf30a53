use super::*;
use crate::identity;
use crate::tests::{PYTORCH, TINY, TRANSFORMERS};

struct Scratch {
    folder: tempfile::TempDir,
    store: Store,
}

impl Scratch {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::at(folder.path().join("not/yet"));
        Self { folder, store }
    }

    fn add(&self, bytes: &[u8], replace: bool) -> Result<Added> {
        let file = self.folder.path().join("file");
        std::fs::write(&file, bytes).unwrap();
        let added = self.store.add(&file, &[TINY], replace);
        added.map(|(known, added)| {
            assert_eq!(known.weights, "tiny");
            added
        })
    }

    fn stored(&self) -> Vec<u8> {
        std::fs::read(self.store.path(&TINY)).unwrap()
    }
}

/// The tiny encoder as a file in single precision.
fn single() -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    std::fs::write(&file, PYTORCH).unwrap();
    let tensors = read_encoder(&file).unwrap();
    let tensors = tensors.into_iter().map(|(name, tensor)| {
        let bytes: Vec<u8> = tensor
            .values()
            .iter()
            .flat_map(|v| v.to_le_bytes())
            .collect();
        (format!("pretrained.{name}"), tensor.shape().to_vec(), bytes)
    });
    let tensors: Vec<_> = tensors.collect();
    let views = tensors.iter().map(|(name, shape, bytes)| {
        (
            name,
            TensorView::new(Dtype::F32, shape.clone(), bytes).unwrap(),
        )
    });
    safetensors::serialize(views, None).unwrap()
}

#[test]
fn every_container_gives_the_same_file() {
    let single = single();
    let mut files = Vec::new();
    for bytes in [PYTORCH, TRANSFORMERS, &single] {
        let scratch = Scratch::new();
        assert_eq!(scratch.add(bytes, false).unwrap(), Added::New);
        let loaded = scratch.store.load(&TINY).unwrap();
        assert_eq!(identity(&loaded), TINY.identity);
        // The file of PyTorch is in half precision, so that nothing is lost.
        let file = scratch.folder.path().join("file");
        assert_eq!(loaded, read_encoder(&file).unwrap());
        files.push(scratch.stored());
        // And what is kept can be given on.
        let stored = scratch.stored();
        assert_eq!(scratch.add(&stored, false).unwrap(), Added::Before);
    }
    assert!(files.windows(2).all(|pair| pair[0] == pair[1]));
}

#[test]
fn what_is_there_is_not_touched() {
    let scratch = Scratch::new();
    scratch.add(PYTORCH, false).unwrap();
    let path = scratch.store.path(&TINY);
    let written = || path.metadata().unwrap().modified().unwrap();
    let (before, bytes) = (written(), scratch.stored());
    assert_eq!(scratch.add(TRANSFORMERS, false).unwrap(), Added::Before);
    assert_eq!((written(), scratch.stored()), (before, bytes.clone()));

    // Nor if it is damaged, unless asked.
    std::fs::write(&path, &bytes[..bytes.len() - 1]).unwrap();
    let error = scratch.add(PYTORCH, false).unwrap_err();
    assert!(error.advice().unwrap().contains("--force"), "{error}");
    assert_eq!(scratch.stored().len(), bytes.len() - 1);
    assert_eq!(scratch.add(PYTORCH, true).unwrap(), Added::New);
    assert_eq!(scratch.stored(), bytes);

    // Nor by what is no encoder.
    assert!(scratch.add(&PYTORCH[..20_000], true).is_err());
    assert_eq!(scratch.stored(), bytes);
}

#[test]
fn damage_since_then_is_noticed() {
    let scratch = Scratch::new();
    scratch.add(PYTORCH, false).unwrap();
    let sound = scratch.stored();
    let tensors = scratch.store.load(&TINY).unwrap();
    let path = scratch.store.path(&TINY);
    let mut noticed = 0;
    for i in 0..500 {
        let mut bytes = sound.clone();
        let place = i * (bytes.len() - 1) / 499;
        bytes[place] ^= 1 << (i % 8);
        std::fs::write(&path, &bytes).unwrap();
        match scratch.store.load(&TINY) {
            Ok(loaded) => assert!(loaded == tensors, "byte {place}"),
            Err(_) => noticed += 1,
        }
    }
    // All but those in what the header says about the licence.
    assert!(noticed > 490, "{noticed}");
    for length in [0, 7, 100, sound.len() - 1] {
        std::fs::write(&path, &sound[..length]).unwrap();
        let error = scratch.store.load(&TINY).unwrap_err();
        assert!(
            error.to_string().contains("is not a tiny encoder any more"),
            "{error}"
        );
    }
}

#[test]
fn what_is_missing_is_said() {
    let scratch = Scratch::new();
    let error = scratch.store.load(&TINY).unwrap_err();
    let text = format!("{error} {}", error.advice().unwrap());
    for words in [
        "`tiny`",
        "a tiny encoder",
        "not/yet",
        "CC0-1.0",
        "MB",
        "`lsdc weights add FILE`",
        "`lsdc weights get tiny`",
    ] {
        assert!(text.contains(words), "`{words}` is missing in: {text}");
    }
    let of_anything = how_to_install(&crate::ANYTHING);
    assert!(
        of_anything.contains("99 MB, of which 44 MB are kept"),
        "{of_anything}"
    );
}

#[test]
fn a_folder_that_cannot_be_written_is_an_error() {
    let scratch = Scratch::new();
    std::fs::write(scratch.folder.path().join("not"), b"a file").unwrap();
    let error = scratch.add(PYTORCH, false).unwrap_err();
    assert_eq!(error.cause(), Cause::Write);
}
