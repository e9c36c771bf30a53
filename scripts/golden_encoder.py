#!/usr/bin/env python3
"""Makes crates/core/src/network/encoder/golden.json, what `transformers` and PyTorch answer where the encoder must
agree with them, and tests/golden/encoder.*: the same tiny network in half precision, as PyTorch saves it with the
names of Depth Anything, and as `transformers` saves it.

Needs torch and transformers 5 (names of layers change with it):

    python3 -m venv target/golden
    target/golden/bin/pip install torch transformers
    target/golden/bin/python scripts/golden_encoder.py

The weights of the tiny network are sines, which the test computes too; only answers are stored.
"""

import json
import tempfile
from pathlib import Path

import torch
from transformers import Dinov2Config, Dinov2Model

ROOT = Path(__file__).resolve().parent.parent
OUT = ROOT / "crates/core/src/network/encoder/golden.json"
FILES = ROOT / "tests/golden"
WIDTH, HEADS, BLOCKS, RATIO, SIDE, PATCH = 16, 2, 3, 2, 4, 14
TAPS = [0, 2]


def sines(index: int, shape, scale: float, offset: float = 0.0) -> torch.Tensor:
    count = torch.Size(shape).numel()
    angles = 0.37 * torch.arange(count, dtype=torch.float64) + index
    return (offset + scale * torch.sin(angles)).float().reshape(shape)


def weights() -> dict[str, torch.Tensor]:
    """By DINOv2's names, in their order here."""
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
    theirs = {}
    for name, value in tensors.items():
        name = name.replace("cls_token", "embeddings.cls_token").replace(
            "pos_embed", "embeddings.position_embeddings").replace(
            "patch_embed.proj", "embeddings.patch_embeddings.projection")
        if name.startswith("blocks."):
            name = "encoder.layer." + name.removeprefix("blocks.")
        name = name.replace("attn.proj", "attention.o_proj").replace(
            "ls1.gamma", "layer_scale1.lambda1").replace("ls2.gamma", "layer_scale2.lambda1")
        if name.startswith("norm."):
            name = "layernorm." + name.removeprefix("norm.")
        if ".attn.qkv" in name:
            for part, third in zip(("q_proj", "k_proj", "v_proj"), value.chunk(3)):
                theirs[name.replace("attn.qkv", f"attention.{part}")] = third
        else:
            theirs[name] = value
    state = net.state_dict()
    missing, unexpected = net.load_state_dict(theirs, strict=False)
    assert not unexpected, unexpected
    assert all("mask_token" in name for name in missing), (missing, list(state)[:5])
    return net


def main() -> None:
    tensors = weights()
    net = model(tensors)
    image = sines(100, (SIDE * PATCH, SIDE * PATCH, 3), 1.5)
    with torch.no_grad():
        answer = net(image.permute(2, 0, 1)[None], output_hidden_states=True)
        # The first of the hidden states is what enters the first block.
        taps = [net.layernorm(answer.hidden_states[tap + 1])[0, 1:] for tap in TAPS]
    table = tensors["pos_embed"][:, 1:].reshape(1, SIDE, SIDE, WIDTH).permute(0, 3, 1, 2)
    positions = []
    for rows, columns in [(4, 4), (3, 5), (7, 2), (1, 9)]:
        # As DINOv2's code does it.
        scale = ((rows + 0.1) / SIDE, (columns + 0.1) / SIDE)
        grid = torch.nn.functional.interpolate(table, scale_factor=scale, mode="bicubic")
        assert grid.shape[2:] == (rows, columns)
        if (rows, columns) == (SIDE, SIDE):
            grid = table
        values = grid[0].permute(1, 2, 0).flatten().tolist()
        positions.append({"size": [rows, columns], "values": [float(f"{v:.9g}") for v in values]})
    plain = [[float(f"{v:.9g}") for v in tap.flatten().tolist()] for tap in taps]
    OUT.write_text(json.dumps({"taps": plain, "positions": positions}) + "\n")
    theirs = {f"pretrained.{name}": value.half() for name, value in tensors.items()}
    theirs["depth_head.scratch"] = torch.ones(3)
    torch.save(theirs, FILES / "encoder.pth")
    with tempfile.TemporaryDirectory() as folder:
        net.half().save_pretrained(folder)
        (FILES / "encoder.safetensors").write_bytes((Path(folder) / "model.safetensors").read_bytes())


if __name__ == "__main__":
    main()
