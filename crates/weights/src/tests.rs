use super::*;
use half::f16;
use lsdc_core::network::EncoderConfig;
use proptest::prelude::*;

/// A tiny encoder in half precision, as saved by other programs (`scripts/golden_encoder.py`).
pub(super) const PYTORCH: &[u8] = include_bytes!("../../../tests/golden/encoder.pth");
pub(super) const TRANSFORMERS: &[u8] = include_bytes!("../../../tests/golden/encoder.safetensors");

/// The known values of the tiny encoder. Its identity was computed in Python.
pub(super) const TINY: KnownEncoder = KnownEncoder {
    weights: "tiny",
    name: "a tiny encoder",
    licence: "CC0-1.0",
    identity: "f1db05f0b25c0cdd80d92d270cd769caf7b70a93b6db76ad3aba0438e15f7dc1",
    sizes: || EncoderConfig {
        width: 16,
        heads: 2,
        blocks: 3,
        hidden: 32,
        side: 4,
        taps: vec![0, 2],
    },
    urls: &["https://example.org/tiny.pth"],
    download_bytes: 60_000,
    extra_time: "nothing",
    head: None,
};

fn read(bytes: &[u8], name: &str) -> Result<BTreeMap<String, Tensor>> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    read_encoder(&path)
}

/// Returns the value `i` of the tensor `index` as computed by the script.
fn sine(index: usize, i: usize, scale: f64, offset: f64) -> f32 {
    let value = (offset + scale * (0.37 * i as f64 + index as f64).sin()) as f32;
    f16::from_f32(value).to_f32()
}

#[test]
fn files_of_pytorch_and_of_transformers_hold_the_same_encoder() {
    let one = read(PYTORCH, "a.pth").unwrap();
    // Four tensors of the image, fourteen per block, two of the last normalisation; no depth head.
    assert_eq!(one.len(), 4 + 3 * 14 + 2);
    assert_eq!(one["blocks.2.attn.qkv.weight"].shape(), [48, 16]);
    let close = |found: &[f32], exact: &dyn Fn(usize) -> f32| {
        let mut pairs = found.iter().enumerate();
        pairs.all(|(i, value)| (value - exact(i)).abs() <= 1e-3 * value.abs().max(1e-3))
    };
    assert!(close(one["cls_token"].values(), &|i| sine(0, i, 0.5, 0.0)));
    assert!(close(one["pos_embed"].values(), &|i| sine(1, i, 0.5, 0.0)));
    assert!(close(one["blocks.0.ls1.gamma"].values(), &|i| sine(
        10, i, 0.3, 0.7
    )));

    let other = read(TRANSFORMERS, "b.safetensors").unwrap();
    assert_eq!(one, other);
    assert_eq!(identity(&one), TINY.identity);
}

#[test]
fn the_encoder_of_anything_has_the_published_size() {
    let shapes = ANYTHING.shapes();
    // DINOv2's table lists 21 M parameters for ViT-S/14; its file has 22,056,576, of which 384 are `mask_token`.
    assert_eq!(
        (shapes.len(), ANYTHING.bytes()),
        (174, 2 * (22_056_576 - 384))
    );
    let tensors = read(PYTORCH, "a.pth").unwrap();
    let shapes = tensors
        .iter()
        .map(|(name, tensor)| (name.clone(), tensor.shape().to_vec()));
    assert_eq!(TINY.shapes(), shapes.collect());
}

#[test]
fn an_encoder_is_recognised_by_its_values() {
    let path = Path::new("a.pth");
    let sound = read(PYTORCH, "a.pth").unwrap();
    let known = [ANYTHING, TINY];
    assert_eq!(recognise(path, &sound, &known).unwrap().weights, "tiny");
    let refused = |tensors: &BTreeMap<String, Tensor>, known: &[KnownEncoder]| {
        let error = recognise(path, tensors, known).unwrap_err();
        format!("{error} {}", error.advice().unwrap())
    };
    let changed = |name: &str, change: &dyn Fn(&Tensor) -> Option<Tensor>| {
        let mut tensors = sound.clone();
        let tensor = change(&tensors[name]);
        tensors.remove(name);
        tensors.extend(tensor.map(|tensor| (name.to_owned(), tensor)));
        tensors
    };

    // The smallest change in half precision.
    let other = changed("norm.bias", &|tensor| {
        let mut values = tensor.values().to_vec();
        values[3] = f32::from_bits(values[3].to_bits() + (1 << 13));
        Tensor::new(tensor.shape().to_vec(), values)
    });
    let message = refused(&other, &known);
    for words in [
        "a.pth",
        "other values",
        "a tiny encoder",
        "f1db05f0b25c",
        "dinov2_vits14",
    ] {
        assert!(message.contains(words), "{message}");
    }
    // A change below half precision.
    let finer = changed("norm.bias", &|tensor| {
        let finer = tensor
            .values()
            .iter()
            .map(|v| f32::from_bits(v.to_bits() + 1));
        Tensor::new(tensor.shape().to_vec(), finer.collect())
    });
    assert!(recognise(path, &finer, &known).is_ok());

    let reshaped = changed("cls_token", &|t| Tensor::new(vec![16], t.values().to_vec()));
    for (tensors, words) in [
        (reshaped, "has `cls_token` of shape 16 instead of 1x1x16"),
        (changed("norm.bias", &|_| None), "has no `norm.bias`"),
    ] {
        let message = refused(&tensors, &[TINY]);
        assert!(
            message.contains(words) && message.contains("a tiny encoder"),
            "{message}"
        );
    }
    let mut more = sound.clone();
    more.insert("blocks.3.norm1.bias".into(), sound["norm.bias"].clone());
    assert!(refused(&more, &[TINY]).contains("has `blocks.3.norm1.bias` too"));
    let message = refused(&sound, &KNOWN);
    assert!(
        message.contains("is not the encoder of Depth Anything V2 Small"),
        "{message}"
    );
}

#[test]
fn what_is_no_encoder_is_refused() {
    for bytes in [&b""[..], b"PK", b"hello", b"\x80\x02}.", &PYTORCH[..2000]] {
        assert!(read(bytes, "a.pth").is_err());
    }
    assert!(read_encoder(Path::new("nowhere.pth")).is_err());
    // The weights of this program.
    assert!(read(lsdc_core::weights::SMALL, "a.safetensors").is_err());
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, rng_seed: proptest::test_runner::RngSeed::Fixed(3), ..ProptestConfig::default() })]

    #[test]
    fn damaged_files_are_errors_or_read(place in 0..PYTORCH.len(), byte: u8, cut: bool) {
        let mut bytes = PYTORCH.to_vec();
        bytes[place] = byte;
        if cut {
            bytes.truncate(place);
        }
        // The result may be an error, but reading ends.
        if let Ok(tensors) = read(&bytes, "a.pth") {
            prop_assert!(tensors.len() <= 48);
        }
    }
}
