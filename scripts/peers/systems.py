"""The systems of the paper's comparison, reimplemented in PyTorch from the publications and the authors' programs; residual
networks are torchvision's. Attributes have the names of lsdc's tensors if possible."""

import math

import torch
from torch import nn
from torch.nn import functional
from torchvision.models.resnet import BasicBlock, Bottleneck
from torchvision.models.resnet import ResNet as Torchvision

KINDS = {"resnet18": (BasicBlock, [2, 2, 2, 2]), "resnet50": (Bottleneck, [3, 4, 6, 3])}


class ResNet(nn.Module):
    """torchvision's ResNet with another first layer, other widths, and no classifier."""

    def __init__(self, kind: str, inputs: int, width: int):
        super().__init__()
        block, counts = KINDS[kind]
        net = Torchvision(block, counts)
        net.inplanes = width
        self.conv1 = nn.Conv2d(inputs, width, 7, 2, 3, bias=False)
        self.bn1 = nn.BatchNorm2d(width)
        self.maxpool = net.maxpool
        for stage, count in enumerate(counts):
            stride = 1 if stage == 0 else 2
            layer = net._make_layer(block, width << stage, count, stride)
            setattr(self, f"layer{stage + 1}", layer)
        self.channels = [(width << stage) * block.expansion for stage in range(4)]

    def forward(self, x):
        stem = self.conv1(x)
        x = self.maxpool(functional.relu(self.bn1(stem)))
        stages = []
        for stage in range(4):
            x = getattr(self, f"layer{stage + 1}")(x)
            stages.append(x)
        return stem, stages


class ConvNorm(nn.Module):
    def __init__(self, inputs, outputs, taps):
        super().__init__()
        self.conv = nn.Conv2d(inputs, outputs, taps, 1, taps // 2, bias=False)
        self.norm = nn.BatchNorm2d(outputs)

    def forward(self, x):
        return self.norm(self.conv(x))


def unpool(x, size=None):
    """Inserts zeros between the pixels."""
    channels = x.shape[1]
    weight = torch.zeros(channels, 1, 2, 2, dtype=x.dtype)
    weight[:, :, 0, 0] = 1
    x = functional.conv_transpose2d(x, weight, stride=2, groups=channels)
    return x if size is None else x[:, :, : size[0], : size[1]]


class UpProj(nn.Module):
    def __init__(self, inputs, outputs):
        super().__init__()
        self.first = ConvNorm(inputs, outputs, 5)
        self.second = ConvNorm(outputs, outputs, 3)
        self.shortcut = ConvNorm(inputs, outputs, 5)

    def forward(self, x, size=None):
        x = unpool(x, size)
        branch = self.second(functional.relu(self.first(x)))
        return functional.relu(branch + self.shortcut(x))


class DeConv(nn.Module):
    def __init__(self, inputs, outputs):
        super().__init__()
        self.conv = nn.ConvTranspose2d(inputs, outputs, 3, 2, 1, 1, bias=False)
        self.norm = nn.BatchNorm2d(outputs)

    def forward(self, x):
        return functional.relu(self.norm(self.conv(x)))


class S2d(nn.Module):
    def __init__(self, encoder="resnet50", decoder="upproj", width=64):
        super().__init__()
        self.resnet = ResNet(encoder, 4, width)
        deepest = self.resnet.channels[-1]
        half = deepest // 2
        self.squeeze = ConvNorm(deepest, half, 1)
        step = UpProj if decoder == "upproj" else DeConv
        self.decoder = nn.ModuleList(step(half >> i, half >> (i + 1)) for i in range(4))
        self.last = nn.Conv2d(half >> 4, 1, 3, 1, 1, bias=False)

    def forward(self, images, sparse):
        size = images.shape[2:]
        _, stages = self.resnet(torch.cat([images, sparse], 1))
        x = self.squeeze(stages[-1])
        for step in self.decoder:
            x = step(x)
        x = functional.interpolate(self.last(x), size, mode="bilinear", align_corners=True)
        return [x[:, 0]]


class Joined(nn.Module):
    def __init__(self, inputs, outputs, side):
        super().__init__()
        self.first = ConvNorm(inputs, outputs, 5)
        self.join = ConvNorm(outputs + side, outputs, 3)
        self.second = ConvNorm(outputs, outputs, 3)
        self.shortcut = ConvNorm(inputs, outputs, 5)

    def forward(self, x, side):
        x = unpool(x, side.shape[2:])
        branch = torch.cat([functional.relu(self.first(x)), side], 1)
        branch = self.second(functional.relu(self.join(branch)))
        return functional.relu(branch + self.shortcut(x))


OFFSETS = [(1, 1), (1, 0), (1, -1), (0, 1), (0, -1), (-1, 1), (-1, 0), (-1, -1)]


def neighbour(x, offset):
    """Returns the value at an offset of rows and columns from each pixel; 0 outside."""
    height, width = x.shape[-2:]
    top, left = 1 + offset[0], 1 + offset[1]
    return functional.pad(x, (1, 1, 1, 1))[..., top : top + height, left : left + width]


def propagate(guidance, start, sparse, steps):
    """Propagates with affinities normalised by the sum of their absolute values; restores known depths after every step."""
    gates = [neighbour(guidance[:, k], offset) for k, offset in enumerate(OFFSETS)]
    total = sum(gate.abs() for gate in gates)
    gates = [gate / total for gate in gates]
    known = sparse.sign()
    depth = start
    for _ in range(steps):
        near = sum(gate * neighbour(depth, offset) for gate, offset in zip(gates, OFFSETS))
        depth = near + (1 - sum(gates)) * start
        depth = (1 - known) * depth + known * sparse
    return depth


class Cspn(nn.Module):
    def __init__(self, encoder="resnet50", width=64, steps=24):
        super().__init__()
        self.steps = steps
        self.resnet = ResNet(encoder, 4, width)
        first, second, third, deepest = self.resnet.channels
        self.middle = ConvNorm(deepest, deepest, 3)
        self.first = UpProj(deepest, third)
        self.joined = nn.ModuleList(
            [Joined(third, second, second), Joined(second, first, first), Joined(first, width, width)]
        )
        self.depth = nn.Conv2d(width, 1, 3, 1, 1, bias=False)
        self.affinity = nn.Conv2d(width, 8, 3, 1, 1, bias=False)

    def forward(self, images, sparse):
        size = images.shape[2:]
        stem, (first, second, third, deepest) = self.resnet(torch.cat([images, sparse], 1))
        x = self.first(self.middle(deepest), third.shape[2:])
        for step, side in zip(self.joined, [second, first, stem]):
            x = step(x, side)
        x = unpool(x, size)
        return [propagate(self.affinity(x), self.depth(x)[:, 0], sparse[:, 0], self.steps)]

    def never_run(self):
        """Returns the parameters of layers that the authors' program creates but never runs."""
        third, width = self.resnet.channels[2], self.depth.in_channels
        layers = [UpProj(third >> i, third >> (i + 1)) for i in range(4)]
        return sum(count(layer) for layer in layers) + 9 * 2 * width


class Pair(nn.Module):
    def __init__(self, inputs, outputs):
        super().__init__()
        self.convs = nn.ModuleList(nn.Conv2d(n, outputs, 3, 1, 1) for n in (inputs, outputs))
        self.norms = nn.ModuleList(nn.BatchNorm2d(outputs) for _ in range(2))

    def forward(self, x):
        for conv, norm in zip(self.convs, self.norms):
            x = functional.relu(norm(conv(x)))
        return x


def join(below, level):
    below = functional.interpolate(below, scale_factor=2, mode="bilinear", align_corners=True)
    down, right = (a - b for a, b in zip(level.shape[2:], below.shape[2:]))
    border = (right // 2, right - right // 2, down // 2, down - down // 2)
    return torch.cat([level, functional.pad(below, border)], 1)


class KernelNet(nn.Module):
    def __init__(self, width):
        super().__init__()
        self.first = Pair(3, width)
        self.down = Pair(width, 8 * width)
        self.up = Pair(9 * width, width)
        self.last = nn.Conv2d(width, 3, 1)

    def forward(self, x):
        level = self.first(x)
        return self.last(self.up(join(self.down(functional.max_pool2d(level, 2)), level)))


class Refinement(nn.Module):
    def __init__(self, width):
        super().__init__()
        widths = [width * times for times in (1, 2, 4, 8, 8)]
        self.first = Pair(4, width)
        self.down = nn.ModuleList(Pair(a, b) for a, b in zip(widths, widths[1:]))
        ups = [(16, 4), (8, 2), (4, 1), (2, 1)]
        self.up = nn.ModuleList(Pair(a * width, b * width) for a, b in ups)
        self.changes = nn.Conv2d(width, 401, 1)
        self.rest = nn.Conv2d(width, 1, 1)

    def forward(self, images, depth):
        x = self.first(torch.cat([images, ((depth - 3.01047486221) / 1.07943839977)[:, None]], 1))
        levels = []
        for down in self.down:
            levels.append(x)
            x = down(functional.max_pool2d(x, 2))
        for up, level in zip(self.up, reversed(levels)):
            x = up(join(x, level))
        rest = 0.08 * torch.sigmoid(self.rest(x)) - 0.04
        bins = torch.arange(401, dtype=x.dtype) / 400 * 8 - 4
        change = (torch.softmax(self.changes(x), 1) * bins[None, :, None, None]).sum(1)
        return depth + change + rest[:, 0]


MEAN = torch.tensor([0.485, 0.456, 0.406])[None, :, None, None]
DEVIATION = torch.tensor([0.229, 0.224, 0.225])[None, :, None, None]


def regress(numbers, sparse, order, most, bounded, h=5.0, held=0.1):
    """Kernel regression in one image, `numbers [3, height, width]`, by dense equations at every pixel."""
    height, width = sparse.shape
    at = sparse.flatten().nonzero()[:, 0]
    rows, columns = at // width, at % width
    sigma, theta, gamma = torch.sigmoid(numbers.flatten(1)[:, at])
    sigma, theta, gamma = 6 * sigma + 1e-5, 2 * math.pi * theta - math.pi, 6 * gamma + 1e-5
    turn = torch.stack([theta.cos(), theta.sin(), -theta.sin(), theta.cos()], -1).view(-1, 2, 2)
    stretch = torch.diag_embed(torch.stack([sigma, 1 / sigma], -1))
    precision = gamma[:, None, None] * turn @ stretch @ turn.transpose(1, 2)
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    down = rows[None] - y.flatten()[:, None]
    right = columns[None] - x.flatten()[:, None]
    _, nearest = torch.sort(down**2 + right**2, dim=1, stable=True)
    nearest = nearest[:, :most]
    offset = torch.stack([down.gather(1, nearest), right.gather(1, nearest)], -1).to(numbers.dtype)
    exponent = torch.einsum("pki,pkij,pkj->pk", offset, precision[nearest], offset)
    exponent = -exponent / (2 * h * h)
    if bounded:
        exponent = 2 * exponent.tanh()
    weights = gamma[nearest] * exponent.exp()
    y, x = (offset / math.sqrt(height * width / len(at))).unbind(-1)
    terms = [torch.ones_like(x)]
    if order > 0:
        terms += [y, x]
    if order > 1:
        terms += [y * y, y * x, x * x]
    terms = torch.stack(terms, -1)
    matrix = torch.einsum("pk,pki,pkj->pij", weights, terms, terms)
    ridge = torch.full((terms.shape[-1],), held, dtype=x.dtype)
    ridge[0] = 0
    matrix = matrix + weights.sum(1)[:, None, None] * torch.diag(ridge)
    right = torch.einsum("pk,pki,pk->pi", weights, terms, sparse.flatten()[at][nearest])
    return torch.linalg.solve(matrix, right)[:, 0].view(height, width)


class Lsk(nn.Module):
    def __init__(self, width=64, order=2, neighbours=32, bounded=True):
        super().__init__()
        self.published = KernelNet(width)
        self.refine = Refinement(width)
        self.order, self.neighbours, self.bounded = order, neighbours, bounded

    def forward(self, images, sparse):
        numbers = self.published(images * DEVIATION + MEAN)
        depth = torch.stack(
            [
                regress(n, s[0], self.order, self.neighbours, self.bounded)
                for n, s in zip(numbers, sparse)
            ]
        )
        known = sparse[:, 0].sign()
        return [(1 - known) * self.refine(images, depth) + sparse[:, 0], depth]


def count(module) -> int:
    return sum(parameter.numel() for parameter in module.parameters())


def named(net: nn.Module, prefix: str) -> dict[str, torch.Tensor]:
    """Returns parameters and running statistics with lsdc's names."""
    found = {}
    state = dict(net.named_parameters()) | dict(net.named_buffers())
    norms = {name for name, m in net.named_modules() if isinstance(m, nn.BatchNorm2d)}
    kinds = {
        "weight": "gain",
        "bias": "shift",
        "running_mean": "running_mean",
        "running_var": "running_variance",
    }
    for name, tensor in state.items():
        place, last = name.rsplit(".", 1)
        if last == "num_batches_tracked":
            continue
        if place in norms:
            last = f"Batch.{kinds[last]}"
        parts = place.split(".")
        if parts[0] == "resnet":
            end = parts[-1]
            if parts[-2] == "downsample":
                parts[-2:] = ["shortcut", "norm" if place in norms else "conv"]
            elif len(parts) == 2:
                parts[-1:] = ["stem", "norm" if place in norms else "conv"]
            else:
                number = str(int(end[-1]) - 1)
                parts[-1:] = ["convs", number, "norm" if place in norms else "conv"]
        if parts[0] == "decoder":
            step = net.decoder[int(parts[1])]
            parts.insert(1, "UpProj" if isinstance(step, UpProj) else "DeConv")
        found[".".join([prefix, *parts, last])] = tensor
    return found
