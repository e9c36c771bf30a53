use super::*;
use crate::tests::{PYTORCH, TINY, TRANSFORMERS};
use crate::{KnownHead, identity, read_encoder};

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

    fn add(&self, bytes: &[u8], replace: bool) -> Result<Installation> {
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

/// The file of the tiny encoder in single precision.
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
        assert_eq!(scratch.add(bytes, false).unwrap(), Installation::New);
        let loaded = scratch.store.load(&TINY).unwrap();
        assert_eq!(identity(&loaded), TINY.identity);
        // The file of PyTorch is in half precision, so that nothing is lost.
        let file = scratch.folder.path().join("file");
        assert_eq!(loaded, read_encoder(&file).unwrap());
        files.push(scratch.stored());
        // The stored file can be added, too.
        let stored = scratch.stored();
        assert_eq!(
            scratch.add(&stored, false).unwrap(),
            Installation::Unchanged
        );
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
    assert_eq!(
        scratch.add(TRANSFORMERS, false).unwrap(),
        Installation::Unchanged
    );
    assert_eq!((written(), scratch.stored()), (before, bytes.clone()));

    // A damaged file is not replaced either, unless requested.
    std::fs::write(&path, &bytes[..bytes.len() - 1]).unwrap();
    let error = scratch.add(PYTORCH, false).unwrap_err();
    assert!(error.advice().unwrap().contains("--force"), "{error}");
    assert_eq!(scratch.stored().len(), bytes.len() - 1);
    assert_eq!(scratch.add(PYTORCH, true).unwrap(), Installation::New);
    assert_eq!(scratch.stored(), bytes);

    // A file without an encoder replaces nothing either.
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
    // All changes except in the licence text of the header.
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
        of_anything.contains("99 MB, of which 50 MB are kept"),
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

/// The tiny encoder with a depth head, whose identity was computed in Python.
const WITH_HEAD: KnownEncoder = KnownEncoder {
    head: Some(KnownHead {
        identity: "323ec0d232f8424d35f1795875b03c369d0496b24e4bb7567970ac8f5c1ff4a3",
        bytes: 16,
    }),
    ..TINY
};

/// Name, shape and values of a tensor.
type Named = (&'static str, &'static [usize], &'static [f32]);

const HEAD: [Named; 2] = [
    (
        "depth_head.projects.0.weight",
        &[2, 3, 1, 1],
        &[0.5, -1.0, 2.0, 0.25, 3.0, -0.125],
    ),
    ("depth_head.resize_layers.3.bias", &[2], &[1.0, -2.0]),
];
/// A different bias.
const CHANGED: Named = ("depth_head.resize_layers.3.bias", &[2], &[1.0, -2.5]);
const LEARNED: Named = ("learned.resize_layers.3.weight", &[1, 2], &[1.0, 2.0]);
const PUBLISHED: Named = ("depth_head.resize_layers.3.weight", &[1, 2], &[3.0, 4.0]);

fn tensors(named: &[Named]) -> BTreeMap<String, Tensor> {
    let tensors = named.iter().map(|(name, shape, values)| {
        let tensor = Tensor::new(shape.to_vec(), values.to_vec()).unwrap();
        ((*name).to_owned(), tensor)
    });
    tensors.collect()
}

/// A file of the encoder, if requested, and of these tensors.
fn file(encoder: bool, head: &[Named]) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("file");
    std::fs::write(&path, PYTORCH).unwrap();
    let mut all = tensors(head);
    if encoder {
        all.extend(read_encoder(&path).unwrap());
    }
    let tensors = all.iter();
    let tensors = tensors.map(|(name, tensor)| (name.clone(), tensor, Precision::Single));
    stored_bytes(tensors, HashMap::new()).unwrap()
}

impl Scratch {
    fn add_with_head(&self, bytes: &[u8], replace: bool) -> Result<Installation> {
        let file = self.folder.path().join("file");
        std::fs::write(&file, bytes).unwrap();
        let added = self.store.add(&file, &[WITH_HEAD], replace);
        added.map(|(_, added)| added)
    }

    fn head(&self) -> BTreeMap<String, Tensor> {
        self.store.load_head(&WITH_HEAD).unwrap()
    }
}

#[test]
fn a_depth_head_is_kept_beside_its_encoder() {
    let [one, other] = HEAD;
    let whole = [one, other, PUBLISHED];
    let scratch = Scratch::new();
    assert!(scratch.store.has_head(&TINY) && !scratch.store.has_head(&WITH_HEAD));
    let bytes = file(true, &whole);
    assert_eq!(
        scratch.add_with_head(&bytes, false).unwrap(),
        Installation::New
    );
    assert!(scratch.store.has_head(&WITH_HEAD));
    assert_eq!(scratch.head(), tensors(&whole));
    // The file of the encoder equals that of a version without heads.
    let plain = Scratch::new();
    plain.add(PYTORCH, false).unwrap();
    assert_eq!(scratch.stored(), plain.stored());
    assert_eq!(
        scratch.add_with_head(&bytes, false).unwrap(),
        Installation::Unchanged
    );
    // A file without a head keeps the existing one.
    assert_eq!(
        scratch.add_with_head(TRANSFORMERS, true).unwrap(),
        Installation::New
    );
    assert_eq!(scratch.head(), tensors(&whole));
}

#[test]
fn a_depth_head_can_be_added_to_an_installed_encoder() {
    let [one, other] = HEAD;
    let scratch = Scratch::new();
    let alone = file(false, &[one, other, LEARNED]);
    let error = scratch.add_with_head(&alone, false).unwrap_err();
    assert!(error.to_string().contains("without the encoder"), "{error}");

    scratch.add(PYTORCH, false).unwrap();
    let error = scratch.store.load_head(&WITH_HEAD).unwrap_err();
    assert!(
        error.to_string().contains("without its depth head")
            && error.advice().unwrap().contains("`lsdc weights add FILE`"),
        "{error}"
    );
    assert_eq!(
        scratch.add_with_head(&alone, false).unwrap(),
        Installation::Head
    );
    assert_eq!(scratch.head(), tensors(&[one, other, LEARNED]));
    assert_eq!(
        scratch.add_with_head(&alone, false).unwrap(),
        Installation::Unchanged
    );
    // The published tensor is added to the learned one, which stays.
    let other_values: Named = (LEARNED.0, LEARNED.1, &[5.0, 6.0]);
    let published = file(true, &[one, other, other_values, PUBLISHED]);
    assert_eq!(
        scratch.add_with_head(&published, false).unwrap(),
        Installation::Head
    );
    let all = tensors(&[one, other, LEARNED, PUBLISHED]);
    assert_eq!(scratch.head(), all);
    assert_eq!(
        scratch.add_with_head(&published, true).unwrap(),
        Installation::New
    );
    let all = tensors(&[one, other, other_values, PUBLISHED]);
    assert_eq!(scratch.head(), all);
}

#[test]
fn other_depth_heads_are_refused_and_damage_is_noticed() {
    let [one, other] = HEAD;
    let scratch = Scratch::new();
    for (encoder, head) in [
        (true, vec![one, CHANGED]),
        (true, vec![one]),
        (false, vec![other]),
    ] {
        let error = scratch.add_with_head(&file(encoder, &head), false);
        let error = error.unwrap_err();
        assert!(error.to_string().contains("other values"), "{error}");
        assert!(!scratch.store.path(&WITH_HEAD).exists());
    }
    scratch
        .add_with_head(&file(true, &[one, other, PUBLISHED]), false)
        .unwrap();
    let path = scratch.store.head_path(&WITH_HEAD);
    let mut bytes = std::fs::read(&path).unwrap();
    // The first tensor of the file.
    let place = bytes.len() - 2 * (6 + 2 + 2);
    bytes[place] ^= 1;
    std::fs::write(&path, &bytes).unwrap();
    let error = scratch.store.load_head(&WITH_HEAD).unwrap_err();
    assert!(error.to_string().contains("any more"), "{error}");
}

#[test]
fn a_head_of_an_encoder_that_has_none_is_left_out() {
    let scratch = Scratch::new();
    let bytes = file(true, &HEAD);
    assert_eq!(scratch.add(&bytes, false).unwrap(), Installation::New);
    assert!(!scratch.store.head_path(&TINY).exists());
}
