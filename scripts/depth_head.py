#!/usr/bin/env python3
"""Learns a replacement of one tensor of the depth head of Depth Anything V2 Small, `depth_head.resize_layers.3.weight`, with all
other tensors frozen.

    python3 scripts/depth_head.py --encoder FILE --head FILE --frames DIR --frames DIR -o tensor.safetensors
    python3 scripts/depth_head.py --encoder FILE --head FILE --start tensor.safetensors --check DIR

FILE: safetensors with the published names, `pretrained.*` and `depth_head.*`; one file may have both. Frames: NAME.jpg with
NAME_depth.png in millimetres, 0 where unknown, at any depth of folders.

Each frame is seen twice, in two sizes, once mirrored. The loss is the mean relative error of inverse depth after the affine map
that is best for each view (weighted least squares), plus the same between both views. The result is the mean of the weights over
the last steps. An interrupted run is continued by the same command. `--check` prints REL and the share of pixels within a
factor of 1.25 after the same affine map, as means over frames.

Needs torch, transformers 5, safetensors, numpy and Pillow.
"""

import argparse
import math
import os
import random
import time
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from PIL import Image, ImageEnhance
from safetensors.torch import load_file, save_file
from transformers import DepthAnythingConfig, DepthAnythingForDepthEstimation, Dinov2Config

from depth_anything import encoder_names, head_names

NAME = "depth_head.resize_layers.3.weight"
PATCH, AREA = 14, 4 / 3
MEAN = torch.tensor([0.485, 0.456, 0.406]).view(3, 1, 1)
DEVIATION = torch.tensor([0.229, 0.224, 0.225]).view(3, 1, 1)
# Shorter sides of both views, for 4:3.
SIDES = (336, 252)
# Weight of the disagreement of both views, and largest relative error that counts.
AGREEMENT, LARGEST = 0.5, 2.0


def network(encoder: Path, head: Path) -> DepthAnythingForDepthEstimation:
    backbone = Dinov2Config(hidden_size=384, num_attention_heads=6, num_hidden_layers=12, image_size=518, patch_size=PATCH,
                            out_indices=[3, 6, 9, 12], reshape_hidden_states=False)
    config = DepthAnythingConfig(backbone_config=backbone, patch_size=PATCH, reassemble_hidden_size=384,
                                 neck_hidden_sizes=[48, 96, 192, 384], fusion_hidden_size=64, head_hidden_size=32)
    net = DepthAnythingForDepthEstimation(config).eval()
    tensors = {name: value.float() for file in {encoder, head} for name, value in load_file(file).items()}

    def part(prefix: str) -> dict[str, torch.Tensor]:
        return {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}

    theirs = {f"backbone.{name}": value for name, value in encoder_names(part("pretrained.")).items()}
    theirs |= head_names(part("depth_head."))
    missing, unexpected = net.load_state_dict(theirs, strict=False)
    assert all("mask_token" in name for name in unexpected), unexpected
    assert all("mask_token" in name or name == learned_name() for name in missing), missing
    return net.requires_grad_(False)


def learned_name() -> str:
    return next(iter(head_names({NAME.removeprefix("depth_head."): torch.empty(0)})))


def frames_below(folders: list[Path]) -> list[Path]:
    files = sorted(Path(place) / name for folder in folders for place, _, names in os.walk(folder, followlinks=True)
                   for name in names if name.endswith(".jpg"))
    found = [image for image in files if image.with_name(f"{image.stem}_depth.png").exists()]
    if not found:
        raise SystemExit("no frame NAME.jpg with NAME_depth.png")
    return found


def read(path: Path) -> tuple[Image.Image, Image.Image]:
    image = Image.open(path).convert("RGB")
    depth = Image.fromarray(np.asarray(Image.open(path.with_name(f"{path.stem}_depth.png"))).astype(np.float32) / 1000)
    return image, depth


def tensors_of(image: Image.Image, depth: Image.Image, side: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Colours [3, h, w] of whole patches, about as many pixels as 4:3 with this shorter side; depths of the same size."""
    patches, aspect = AREA * (side / PATCH) ** 2, image.height / image.width
    rows, columns = round((patches * aspect) ** 0.5), round((patches / aspect) ** 0.5)
    size = (PATCH * columns, PATCH * rows)
    colours = torch.from_numpy(np.asarray(image.resize(size, Image.Resampling.BICUBIC)).copy()).permute(2, 0, 1) / 255
    depths = torch.from_numpy(np.asarray(depth.resize(size, Image.Resampling.NEAREST)).copy())
    return (colours - MEAN) / DEVIATION, depths


def augmented(frame: Path, rng: random.Random) -> list[tuple[torch.Tensor, torch.Tensor, bool]]:
    image, depth = read(frame)
    width, height = image.size
    share = rng.uniform(0.7, 1.0)
    w, h = int(share * width), int(share * height)
    left, top = rng.randint(0, width - w), rng.randint(0, height - h)
    box = (left, top, left + w, top + h)
    image = image.crop(box)
    depth = depth.resize((width, height), Image.Resampling.NEAREST).crop(box)
    views = []
    for side, mirrored in zip(rng.sample(SIDES, 2), (False, True)):
        seen = image
        for change in (ImageEnhance.Brightness, ImageEnhance.Contrast, ImageEnhance.Color):
            seen = change(seen).enhance(rng.uniform(0.8, 1.25))
        colours, depths = tensors_of(seen, depth, side)
        if mirrored:
            colours, depths = colours.flip(2), depths.flip(1)
        views.append((colours, depths, mirrored))
    return views


def predicted(net: DepthAnythingForDepthEstimation, colours: torch.Tensor) -> torch.Tensor:
    """Relative inverse depths [h, w]."""
    rows, columns = colours.shape[1] // PATCH, colours.shape[2] // PATCH
    with torch.no_grad():
        taps = net.backbone(colours[None]).feature_maps
    return net.head(net.neck(taps, rows, columns), rows, columns)[0]


def relative(prediction: torch.Tensor, inverse: torch.Tensor, known: torch.Tensor) -> torch.Tensor:
    """Relative errors of inverse depths at known pixels, after the affine map with the least weighted squares."""
    x, y = prediction[known], inverse[known]
    rows = torch.stack([x / y, 1 / y], 1)
    normal = rows.T @ rows + 1e-6 * torch.eye(2) * (rows**2).sum() / 2
    solution = torch.linalg.solve(normal, rows.T @ torch.ones_like(y))
    return rows @ solution - 1


def loss_of(net: DepthAnythingForDepthEstimation, views: list) -> torch.Tensor | None:
    maps, losses = [], []
    for colours, depths, mirrored in views:
        known = depths > 0
        if known.sum() < 1000:
            return None
        prediction = predicted(net, colours)
        losses.append(relative(prediction, 1 / depths.clamp(min=1e-3), known).abs().clamp(max=LARGEST).mean())
        maps.append(prediction.flip(1) if mirrored else prediction)
    larger, smaller = sorted(maps, key=torch.numel, reverse=True)
    larger = F.interpolate(larger[None, None], smaller.shape, mode="area")[0, 0]
    target = larger.detach() + 0.1 * larger.detach().mean()
    apart = relative(smaller, target, torch.ones_like(target, dtype=torch.bool)).abs().clamp(max=LARGEST).mean()
    return sum(losses) / 2 + AGREEMENT * apart


def learn(net: DepthAnythingForDepthEstimation, frames: list[Path], args: argparse.Namespace) -> torch.Tensor:
    weight = net.get_parameter(learned_name()).requires_grad_(True)
    with torch.no_grad():
        weight.zero_()
    mean = weight.detach().clone()
    optimiser = torch.optim.Adam([weight], lr=args.rate)
    state, first = args.output.with_suffix(".state"), 0
    if state.exists():
        saved = torch.load(state)
        first, mean = saved["step"], saved["mean"]
        optimiser.load_state_dict(saved["optimiser"])
        with torch.no_grad():
            weight.copy_(saved["weight"])
    began, recent = time.time(), []
    for step in range(first, args.steps):
        rng = random.Random(f"{args.seed} {step}")
        for group in optimiser.param_groups:
            group["lr"] = args.rate * min(1, (step + 1) / 30) * 0.5 * (1 + math.cos(math.pi * step / args.steps))
        optimiser.zero_grad()
        for frame in rng.sample(frames, args.batch):
            loss = loss_of(net, augmented(frame, rng))
            if loss is not None:
                (loss / args.batch).backward()
                recent.append(float(loss.detach()))
        optimiser.step()
        keep = min(0.99, step / (step + 10))
        mean.lerp_(weight.detach(), 1 - keep)
        if (step + 1) % 25 == 0 or step + 1 == args.steps:
            partial = state.with_suffix(".part")
            torch.save({"step": step + 1, "mean": mean, "weight": weight.detach(), "optimiser": optimiser.state_dict()}, partial)
            partial.replace(state)
            print(f"step {step + 1}: loss {np.mean(recent):.4f}, {time.time() - began:.0f} s", flush=True)
            recent = []
    return mean


def check(net: DepthAnythingForDepthEstimation, frames: list[Path]) -> None:
    results = []
    for frame in frames:
        colours, depths = tensors_of(*read(frame), SIDES[0])
        known = depths > 0
        with torch.no_grad():
            ratio = 1 + relative(predicted(net, colours), 1 / depths.clamp(min=1e-3), known)
        # The depth is the inverse of the aligned value.
        ratio = 1 / ratio.clamp(min=1e-2)
        within = torch.maximum(ratio, 1 / ratio) < 1.25
        results.append((float((ratio - 1).abs().mean()), float(within.float().mean())))
    rel, share = np.mean(results, 0)
    print(f"{len(frames)} frames: REL {rel:.4f}, within 1.25 {share:.3f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--encoder", type=Path, required=True)
    parser.add_argument("--head", type=Path, required=True)
    parser.add_argument("--frames", type=Path, action="append", default=[])
    parser.add_argument("--check", type=Path, action="append", default=[], help="only measure, on these frames")
    parser.add_argument("--start", type=Path, help="the tensor to measure")
    parser.add_argument("--every", type=int, default=1, help="only every such frame of --check")
    parser.add_argument("-o", "--output", type=Path, default=Path("tensor.safetensors"))
    parser.add_argument("--steps", type=int, default=1500)
    parser.add_argument("--batch", type=int, default=2)
    parser.add_argument("--rate", type=float, default=2.5e-4)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    net = network(args.encoder, args.head)
    if args.check:
        if args.start:
            with torch.no_grad():
                net.get_parameter(learned_name()).copy_(next(iter(load_file(args.start).values())).float())
        for folder in args.check:
            check(net, frames_below([folder])[:: args.every])
        return
    weight = learn(net, frames_below(args.frames), args)
    save_file({NAME: weight.half()}, args.output)


if __name__ == "__main__":
    main()
