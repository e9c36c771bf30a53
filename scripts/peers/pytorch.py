"""The network of a weights file in PyTorch, channels last: image to basis functions, and a training step."""

import json

import numpy as np
import torch
from network import EPSILON, backbone_blocks, encode
from safetensors import safe_open
from torch import nn
from torch.nn import functional
from torch.nn.utils.fusion import fuse_conv_bn_eval


def tensor(value: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(value, np.float32))


class Unit(nn.Module):
    """Convolution, batch normalisation, ReLU."""

    def __init__(
        self, weight: np.ndarray, norm: dict | None, stride=1, dilation=1, relu=False, groups=1
    ):
        super().__init__()
        outputs, inputs, taps, _ = weight.shape
        pad = dilation * (taps // 2)
        self.conv = nn.Conv2d(
            inputs * groups, outputs, taps, stride, pad, dilation, groups, bias=False
        )
        self.norm = nn.BatchNorm2d(outputs, eps=EPSILON) if norm else None
        self.relu = relu
        with torch.no_grad():
            self.conv.weight.copy_(tensor(weight))
            if norm:
                for own, name in [
                    (self.norm.weight, "gain"),
                    (self.norm.bias, "shift"),
                    (self.norm.running_mean, "running_mean"),
                    (self.norm.running_var, "running_variance"),
                ]:
                    own.copy_(tensor(norm[name]))

    def fold(self) -> None:
        if self.norm is not None:
            self.conv, self.norm = fuse_conv_bn_eval(self.conv, self.norm), None

    def forward(self, x):
        x = self.conv(x)
        if self.norm is not None:
            x = self.norm(x)
        return functional.relu(x, inplace=True) if self.relu else x


def run(stage: nn.ModuleList, x):
    """Runs residual blocks, one after the other."""
    for block in stage:
        y = block["second"](block["first"](x))
        x = y + (block["shortcut"](x) if "shortcut" in block else x)
    return x


class Inverted(nn.Module):
    """An inverted residual block of the backbone."""

    def __init__(self, units: list[Unit], adds: bool, read: bool):
        super().__init__()
        self.units = nn.Sequential(*units)
        self.adds, self.read = adds, read

    def forward(self, x):
        y = self.units(x)
        return y + x if self.adds else y


class Network(nn.Module):
    """Maps an image `[batch, 3, height, width]` to basis functions `[batch, N, height, width]`, after the mean, if any."""

    def __init__(self, path: str):
        super().__init__()
        with safe_open(path, "np") as file:
            config = json.loads(file.metadata()["network"])
            tensors = {name: file.get_tensor(name) for name in file.keys()}
        self.octaves = config["octaves"]
        extractor = config["extractor"]
        self.pools = extractor["pools"]

        def unit(name: str, stride=1, dilation=1, relu=True, groups=1) -> Unit:
            weight = tensors[f"{name}.conv.weight"]
            return Unit(weight, norm(name), stride, dilation, relu, groups)

        def norm(name: str) -> dict:
            keys = ("gain", "shift", "running_mean", "running_variance")
            return {key: tensors[f"{name}.norm.Batch.{key}"] for key in keys}

        def stage(name: str, blocks: int, stride: int, dilation: int) -> nn.ModuleList:
            found = nn.ModuleList()
            for at in (f"{name}.{block}" for block in range(blocks)):
                parts = {
                    "first": unit(f"{at}.first", stride, dilation),
                    "second": unit(f"{at}.second", 1, dilation, relu=False),
                }
                if f"{at}.shortcut.conv.weight" in tensors:
                    parts["shortcut"] = unit(f"{at}.shortcut", stride, relu=False)
                found.append(nn.ModuleDict(parts))
                stride = 1
            return found

        self.stem = nn.Sequential(
            *(unit(f"extractor.stem.{i}", 2 if i == 0 else 1) for i in range(3))
        )
        self.stages = nn.ModuleList(
            stage(f"extractor.{name}", extractor["stages"][i]["blocks"], stride, dilation)
            for i, (name, stride, dilation) in enumerate(
                [("half", 1, 1), ("quarter", 2, 1), ("wide", 1, 1), ("dilated", 1, 2)]
            )
        )
        context = extractor.get("context", [])
        self.context = nn.ModuleList(
            stage(f"extractor.context.{i}.blocks", own["blocks"], 2, 1)
            for i, own in enumerate(context)
        )
        self.seen = nn.ModuleList(
            Unit(tensors[f"extractor.context.{i}.project.weight"], None)
            for i in range(len(context))
        )
        self.backbone = nn.ModuleList()
        if stages := (extractor.get("backbone") or {}).get("stages", 0):
            at = "extractor.backbone"
            self.backbone_stem = unit(f"{at}.stem", 2)
            for i, block in enumerate(backbone_blocks(stages)):
                name = f"{at}.blocks.{i}"
                expands = f"{name}.expand.conv.weight" in tensors
                inner = len(tensors[f"{name}.depthwise.conv.weight"])
                units = [
                    *([unit(f"{name}.expand")] if expands else []),
                    unit(f"{name}.depthwise", block["stride"], groups=inner),
                    unit(f"{name}.project", relu=False),
                ]
                self.backbone.append(Inverted(units, block["adds"], block["read"]))
            at = "extractor.decoder"
            plain = lambda name: Unit(tensors[f"{at}.{name}.weight"], None)
            reads = sum(block.read for block in self.backbone)
            self.lateral_maps = nn.ModuleList(plain(f"lateral.{i}") for i in range(reads))
            self.mix_maps = nn.ModuleList(unit(f"{at}.mix.{i}") for i in range(reads))
            self.decoded = plain("features")
            self.logarithm = plain("map") if config.get("mean") else None
        self.branches = nn.ModuleList(
            unit(f"extractor.branches.{i}") for i in range(len(self.pools))
        )
        self.merge = unit("extractor.merge")
        self.project = Unit(tensors["extractor.project.weight"], None)
        count = extractor.get("sharpening", 0)
        if count > 0:
            self.lateral = Unit(tensors["extractor.sharpen.lateral.weight"], None)
            self.mix = nn.Sequential(*(unit(f"extractor.sharpen.mix.{i}") for i in range(count)))
            self.sharp = Unit(tensors["extractor.sharpen.last.weight"], None)
        pointwise = lambda matrix: matrix.T[:, :, None, None]
        self.hidden = nn.Sequential(
            *(
                Unit(
                    pointwise(tensors[f"head.hidden.{i}.linear.weight"]),
                    norm(f"head.hidden.{i}"),
                    relu=True,
                )
                for i in range(len(config["hidden"]))
            )
        )
        self.last = Unit(pointwise(tensors["head.last.weight"]), None)
        mean = tensors.get("head.mean.weight") if config.get("mean") else None
        self.mean = None if mean is None else Unit(pointwise(mean), None)
        self.has_map = bool(config.get("mean"))
        self.codes = {}

    def fold(self) -> "Network":
        """Folds normalisation into the weights."""
        self.eval()
        for module in self.modules():
            if isinstance(module, Unit):
                module.fold()
        return self

    def pyramid(self, image):
        """Returns the last level of the feature pyramid on the backbone."""
        maps, y = [], self.backbone_stem(image)
        for block in self.backbone:
            y = block(y)
            if block.read:
                maps.append(y)
        levels = list(zip(maps, self.lateral_maps, self.mix_maps))
        x = None
        for map, lateral, mix in reversed(levels):
            own = lateral(map)
            if x is not None:
                own = own + functional.interpolate(x, own.shape[2:], mode="bilinear")
            x = mix(own)
        return x

    def forward(self, image):
        batch, _, height, width = image.shape
        if (height, width) not in self.codes:
            codes = tensor(encode(height, width, self.octaves))
            self.codes[height, width] = codes.to(image.device)
        x = self.stem(image)
        taps = []
        for stage in self.stages:
            x = run(stage, x)
            taps.append(x)
        raw, skip = taps[1], taps[3]
        parts = [raw, skip]
        for pool, branch in zip(self.pools, self.branches):
            y = branch(
                functional.avg_pool2d(skip, pool, ceil_mode=True, count_include_pad=False)
            )
            parts.append(functional.interpolate(y, raw.shape[2:], mode="bilinear"))
        x = self.project(self.merge(torch.cat(parts, 1)))
        y = skip
        for stage, seen in zip(self.context, self.seen):
            y = run(stage, y)
            x = x + functional.interpolate(seen(y), x.shape[2:], mode="bilinear")
        logarithm = None
        if len(self.backbone) > 0:
            decoded = self.pyramid(image)
            add = self.decoded(decoded)
            x = x + functional.interpolate(add, x.shape[2:], mode="bilinear")
            logarithm = None if self.logarithm is None else self.logarithm(decoded)
        if hasattr(self, "mix"):
            x = functional.interpolate(x, taps[0].shape[2:], mode="bilinear")
            if logarithm is not None:
                logarithm = functional.interpolate(logarithm, x.shape[2:], mode="bilinear")
            x = x + self.sharp(self.mix(x + self.lateral(taps[0])))
        x = functional.interpolate(x, (height, width), mode="bilinear")
        x = torch.cat([x, self.codes[height, width].expand(batch, -1, -1, -1)], 1)
        x = self.hidden(x)
        bases = self.last(x)
        if logarithm is not None:
            logarithm = functional.interpolate(logarithm, (height, width), mode="bilinear")
        elif self.mean is not None:
            logarithm = self.mean(x)
        return bases if logarithm is None else torch.cat([logarithm.exp(), bases], 1)


def trainer(path: str, height: int, width: int, batch: int, points: int, device: str = "cpu"):
    """Returns a function that makes one step like `lsdc bench --training`: all pixels in the three losses, a fit in f64
    with a ridge of 1e-4, Adam."""
    net = Network(path).to(device, memory_format=torch.channels_last).train()
    optimiser = torch.optim.Adam(net.parameters(), 1e-4, weight_decay=5e-4)
    generator = torch.Generator().manual_seed(0)
    image = torch.randn((batch, 3, height, width), generator=generator)
    image = image.to(device, memory_format=torch.channels_last)
    depth = (1 + torch.rand((batch, height * width, 1), generator=generator)).to(device)
    pixels = torch.randint(height * width, (batch, points), generator=generator).to(device)

    def step() -> None:
        bases = net(image).permute(0, 2, 3, 1).flatten(1, 2)
        if not net.has_map:
            bases = torch.cat([torch.ones_like(bases[..., :1]), bases], 2)
        at = lambda values: values.gather(1, pixels[..., None].expand(-1, -1, values.shape[2]))
        rows, known = at(bases).double(), at(depth).double()
        normal = rows.mT @ rows
        share = 1e-4 * normal.diagonal(dim1=1, dim2=2).mean(1)
        eye = torch.eye(normal.shape[1], dtype=normal.dtype, device=device)
        normal = normal + share[:, None, None] * eye
        weights = torch.cholesky_solve(rows.mT @ known, torch.linalg.cholesky(normal))
        error = bases @ weights.float() - depth
        map = error.view(batch, height, width)
        slopes = [map.diff(dim=1).abs(), map.diff(dim=2).abs()]
        gradient = sum(s.sum() for s in slopes) / sum(s.numel() for s in slopes)
        loss = error.abs().mean() + error.square().mean() + gradient
        loss = loss + 1e-3 * weights.float().abs().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()

    return step
