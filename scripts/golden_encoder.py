#!/usr/bin/env python3
"""Makes crates/core/src/network/encoder/golden.json, results of `transformers` and PyTorch with which the encoder must
agree; depth_head.json beside it, results of the depth head; and tests/golden/encoder.*, the same tiny network in half
precision, as saved by PyTorch with the names of Depth Anything, and as saved by `transformers`.

Needs torch and transformers 5 (names of layers change with it):

    python3 -m venv target/golden
    target/golden/bin/pip install torch transformers
    target/golden/bin/python scripts/golden_encoder.py

The weights of the tiny network are sines, which the test computes as well; only results are stored.
"""

import json
import tempfile
from pathlib import Path

import torch
from depth_anything import encoder_names, head_names
from transformers import DepthAnythingConfig, DepthAnythingForDepthEstimation, Dinov2Config, Dinov2Model

ROOT = Path(__file__).resolve().parent.parent
OUT = ROOT / "crates/core/src/network/encoder/golden.json"
FILES = ROOT / "tests/golden"
WIDTH, HEADS, BLOCKS, RATIO, SIDE, PATCH = 16, 2, 3, 2, 4, 14
TAPS = [0, 2]
# The tiny depth head: channels of its four maps, of the fused map, and of the last layers; rows and columns of patches.
HEAD, FUSED, FINE, GRIDS = [4, 6, 8, 10], 6, 7, [(3, 5), (1, 2)]


def sines(index: int, shape, scale: float, offset: float = 0.0) -> torch.Tensor:
    count = torch.Size(shape).numel()
    angles = 0.37 * torch.arange(count, dtype=torch.float64) + index
    return (offset + scale * torch.sin(angles)).float().reshape(shape)


def weights() -> dict[str, torch.Tensor]:
    """Weights of the tiny encoder, with DINOv2's names, in a fixed order."""
    shapes = {
        "cls_token": ((1, 1, WIDTH), 0.5, 0.0),
        "pos_embed": ((1, 1 + SIDE**2, WIDTH), 0.5, 0.0),
        "patch_embed.proj.weight": ((WIDTH, 3, PATCH, PATCH), 0.05, 0.0),
        "patch_embed.proj.bias": ((WIDTH,), 0.1, 0.0),
    }
    for block in range(BLOCKS):
        part = {
            "norm1.weight": ((WIDTH,), 0.3, 1.0),
            "norm1.bias": ((WIDTH,), 0.1, 0.0),
            "attn.qkv.weight": ((3 * WIDTH, WIDTH), 0.4, 0.0),
            "attn.qkv.bias": ((3 * WIDTH,), 0.1, 0.0),
            "attn.proj.weight": ((WIDTH, WIDTH), 0.3, 0.0),
            "attn.proj.bias": ((WIDTH,), 0.1, 0.0),
            "ls1.gamma": ((WIDTH,), 0.3, 0.7),
            "norm2.weight": ((WIDTH,), 0.3, 1.0),
            "norm2.bias": ((WIDTH,), 0.1, 0.0),
            "mlp.fc1.weight": ((RATIO * WIDTH, WIDTH), 0.3, 0.0),
            "mlp.fc1.bias": ((RATIO * WIDTH,), 0.1, 0.0),
            "mlp.fc2.weight": ((WIDTH, RATIO * WIDTH), 0.3, 0.0),
            "mlp.fc2.bias": ((WIDTH,), 0.1, 0.0),
            "ls2.gamma": ((WIDTH,), 0.3, 0.7),
        }
        shapes |= {f"blocks.{block}.{name}": value for name, value in part.items()}
    shapes |= {"norm.weight": ((WIDTH,), 0.3, 1.0), "norm.bias": ((WIDTH,), 0.1, 0.0)}
    return {name: sines(i, *of) for i, (name, of) in enumerate(shapes.items())}


def model(tensors: dict[str, torch.Tensor]) -> Dinov2Model:
    config = Dinov2Config(hidden_size=WIDTH, num_attention_heads=HEADS, num_hidden_layers=BLOCKS,
                          mlp_ratio=RATIO, image_size=SIDE * PATCH, patch_size=PATCH)
    net = Dinov2Model(config).eval()
    state = net.state_dict()
    missing, unexpected = net.load_state_dict(encoder_names(tensors), strict=False)
    assert not unexpected, unexpected
    assert all("mask_token" in name for name in missing), (missing, list(state)[:5])
    return net


def head_weights() -> dict[str, torch.Tensor]:
    """Weights of the tiny depth head, with the published names, in a fixed order."""
    half = FUSED // 2
    shapes = {}
    for i, own in enumerate(HEAD):
        shapes[f"projects.{i}.weight"] = (own, WIDTH, 1, 1)
        shapes[f"projects.{i}.bias"] = (own,)
    for i, side in ((0, 4), (1, 2), (3, 3)):
        shapes[f"resize_layers.{i}.weight"] = (HEAD[i], HEAD[i], side, side)
        shapes[f"resize_layers.{i}.bias"] = (HEAD[i],)
    for i, own in enumerate(HEAD):
        shapes[f"scratch.layer{i + 1}_rn.weight"] = (FUSED, own, 3, 3)
    for i in range(1, 5):
        for unit in (1, 2):
            for conv in (1, 2):
                name = f"scratch.refinenet{i}.resConfUnit{unit}.conv{conv}"
                shapes |= {f"{name}.weight": (FUSED, FUSED, 3, 3), f"{name}.bias": (FUSED,)}
        name = f"scratch.refinenet{i}.out_conv"
        shapes |= {f"{name}.weight": (FUSED, FUSED, 1, 1), f"{name}.bias": (FUSED,)}
    for name, shape in (("output_conv1", (half, FUSED, 3, 3)), ("output_conv2.0", (FINE, half, 3, 3)),
                        ("output_conv2.2", (1, FINE, 1, 1))):
        shapes |= {f"scratch.{name}.weight": shape, f"scratch.{name}.bias": shape[:1]}
    made = {}
    for i, (name, shape) in enumerate(shapes.items()):
        if len(shape) > 1:
            # Large enough to preserve the scale of values.
            made[name] = sines(200 + i, shape, 2.0 / torch.Size(shape[1:]).numel() ** 0.5)
        else:
            # The last bias is large enough to make most depths positive.
            made[name] = sines(200 + i, shape, 0.2, 2.0 if i + 1 == len(shapes) else 0.1)
    return made


def head_model(tensors: dict[str, torch.Tensor]) -> DepthAnythingForDepthEstimation:
    backbone = Dinov2Config(hidden_size=WIDTH, num_attention_heads=HEADS, num_hidden_layers=4, mlp_ratio=RATIO,
                            image_size=SIDE * PATCH, patch_size=PATCH, out_indices=[1, 2, 3, 4],
                            reshape_hidden_states=False)
    config = DepthAnythingConfig(backbone_config=backbone, reassemble_hidden_size=WIDTH, patch_size=PATCH,
                                 neck_hidden_sizes=HEAD, fusion_hidden_size=FUSED, head_hidden_size=FINE)
    net = DepthAnythingForDepthEstimation(config).eval()
    missing, unexpected = net.load_state_dict(head_names(tensors), strict=False)
    assert not unexpected, unexpected
    assert all(name.startswith("backbone.") for name in missing), missing
    return net


def golden_head() -> list[dict]:
    net = head_model(head_weights())
    cases = []
    for rows, columns in GRIDS:
        # With the class token, which is left out.
        taps = [torch.cat([torch.zeros(1, 1, WIDTH), sines(300 + i, (1, rows * columns, WIDTH), 1.0)], 1)
                for i in range(4)]
        with torch.no_grad():
            depth = net.head(net.neck(taps, rows, columns), rows, columns)
        values = depth.flatten().tolist()
        share = sum(v > 0 for v in values) / len(values)
        assert share > 0.5, share
        cases.append({"size": [rows, columns], "values": [float(f"{v:.7g}") for v in values]})
    return cases


def main() -> None:
    tensors = weights()
    net = model(tensors)
    image = sines(100, (SIDE * PATCH, SIDE * PATCH, 3), 1.5)
    with torch.no_grad():
        answer = net(image.permute(2, 0, 1)[None], output_hidden_states=True)
        # The first hidden state is the input of the first block.
        taps = [net.layernorm(answer.hidden_states[tap + 1])[0, 1:] for tap in TAPS]
    table = tensors["pos_embed"][:, 1:].reshape(1, SIDE, SIDE, WIDTH).permute(0, 3, 1, 2)
    positions = []
    for rows, columns in [(4, 4), (3, 5), (7, 2), (1, 9)]:
        # As in DINOv2's code.
        scale = ((rows + 0.1) / SIDE, (columns + 0.1) / SIDE)
        grid = torch.nn.functional.interpolate(table, scale_factor=scale, mode="bicubic")
        assert grid.shape[2:] == (rows, columns)
        if (rows, columns) == (SIDE, SIDE):
            grid = table
        values = grid[0].permute(1, 2, 0).flatten().tolist()
        positions.append({"size": [rows, columns], "values": [float(f"{v:.9g}") for v in values]})
    plain = [[float(f"{v:.9g}") for v in tap.flatten().tolist()] for tap in taps]
    OUT.write_text(json.dumps({"taps": plain, "positions": positions}) + "\n")
    OUT.with_name("depth_head.json").write_text(json.dumps(golden_head()) + "\n")
    theirs = {f"pretrained.{name}": value.half() for name, value in tensors.items()}
    theirs["depth_head.scratch"] = torch.ones(3)
    torch.save(theirs, FILES / "encoder.pth")
    with tempfile.TemporaryDirectory() as folder:
        net.half().save_pretrained(folder)
        (FILES / "encoder.safetensors").write_bytes((Path(folder) / "model.safetensors").read_bytes())


if __name__ == "__main__":
    main()
