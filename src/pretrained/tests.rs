use super::*;
use proptest::prelude::*;

/// A tiny encoder in half precision, as other programs save it (`scripts/golden_encoder.py`).
const PYTORCH: &[u8] = include_bytes!("../../tests/golden/encoder.pth");
const TRANSFORMERS: &[u8] = include_bytes!("../../tests/golden/encoder.safetensors");

fn read(bytes: &[u8], name: &str) -> Result<BTreeMap<String, Tensor>> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    read_encoder(&path)
}

/// What the script draws the tensor from that is the `index`th there.
fn sine(index: usize, i: usize, scale: f64, offset: f64) -> f32 {
    let value = (offset + scale * (0.37 * i as f64 + index as f64).sin()) as f32;
    f16::from_f32(value).to_f32()
}

#[test]
fn files_of_pytorch_and_of_transformers_hold_the_same_encoder() {
    let one = read(PYTORCH, "a.pth").unwrap();
    // Four of the image, fourteen of each block, two of the last normalisation; no depth head.
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
    assert_eq!(identity(&one), identity(&other));
}

#[test]
fn other_values_are_no_known_encoder() {
    let mut tensors = read(PYTORCH, "a.pth").unwrap();
    let before = identity(&tensors);
    let shift = &tensors["norm.bias"];
    let mut values = shift.values().to_vec();
    values[3] += 0.01;
    let changed = Tensor::new(shift.shape().to_vec(), values).unwrap();
    tensors.insert("norm.bias".into(), changed);
    assert_ne!(before, identity(&tensors));
    let error = known(Path::new("a.pth"), &tensors).unwrap_err();
    assert!(error.with_causes().contains("a.pth"));
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
        // An error or not, it ends.
        if let Ok(tensors) = read(&bytes, "a.pth") {
            prop_assert!(tensors.len() <= 48);
        }
    }
}
