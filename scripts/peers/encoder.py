"""The vision transformer of DINOv2 (ViT-S/14) in PyTorch, with random weights and DINOv2's names."""

import torch
from torch import nn
from torch.nn import functional

WIDTH, HEADS, BLOCKS, SIDE, PATCH = 384, 6, 12, 37, 14
TAPS = [2, 5, 8, 11]


class Attention(nn.Module):
    def __init__(self):
        super().__init__()
        self.qkv = nn.Linear(WIDTH, 3 * WIDTH)
        self.proj = nn.Linear(WIDTH, WIDTH)

    def forward(self, x):
        parts = self.qkv(x).unflatten(-1, (3, HEADS, WIDTH // HEADS))
        q, k, v = parts.permute(2, 0, 3, 1, 4)
        x = functional.scaled_dot_product_attention(q, k, v)
        return self.proj(x.transpose(1, 2).flatten(2))


class Perceptron(nn.Module):
    def __init__(self):
        super().__init__()
        self.fc1 = nn.Linear(WIDTH, 4 * WIDTH)
        self.fc2 = nn.Linear(4 * WIDTH, WIDTH)

    def forward(self, x):
        return self.fc2(functional.gelu(self.fc1(x)))


class Scale(nn.Module):
    def __init__(self):
        super().__init__()
        self.gamma = nn.Parameter(torch.ones(WIDTH))


class Block(nn.Module):
    def __init__(self):
        super().__init__()
        self.norm1 = nn.LayerNorm(WIDTH, eps=1e-6)
        self.attn = Attention()
        self.ls1 = Scale()
        self.norm2 = nn.LayerNorm(WIDTH, eps=1e-6)
        self.mlp = Perceptron()
        self.ls2 = Scale()

    def forward(self, x):
        x = x + self.attn(self.norm1(x)) * self.ls1.gamma
        return x + self.mlp(self.norm2(x)) * self.ls2.gamma


class Patches(nn.Module):
    def __init__(self):
        super().__init__()
        self.proj = nn.Conv2d(3, WIDTH, PATCH, PATCH)


class Encoder(nn.Module):
    """Maps normalised images `[1, 3, height, width]` to features `[taps, patches, channels]`."""

    def __init__(self, rows: int, columns: int):
        super().__init__()
        self.cls_token = nn.Parameter(torch.zeros(1, 1, WIDTH))
        self.pos_embed = nn.Parameter(torch.zeros(1, 1 + SIDE**2, WIDTH))
        self.patch_embed = Patches()
        self.blocks = nn.ModuleList(Block() for _ in range(BLOCKS))
        self.norm = nn.LayerNorm(WIDTH, eps=1e-6)
        self.register_buffer("places", torch.zeros(1, 1 + rows * columns, WIDTH), False)
        self.size = rows, columns

    @torch.no_grad()
    def randomise(self) -> dict[str, torch.Tensor]:
        """Sets random weights that keep values in a range, like trained ones; returns them by name."""
        generator = torch.Generator().manual_seed(0)
        for name, value in self.named_parameters():
            mean = 1.0 if "norm" in name and name.endswith("weight") else 0.0
            mean = 0.5 if name.endswith("gamma") else mean
            value.copy_(mean + 0.05 * torch.randn(value.shape, generator=generator))
        self.place()
        return {name: value.detach().clone() for name, value in self.named_parameters()}

    def place(self) -> None:
        """Returns the position embeddings for the size of the image, interpolated as in DINOv2."""
        rows, columns = self.size
        table = self.pos_embed[:, 1:].unflatten(1, (SIDE, SIDE)).permute(0, 3, 1, 2)
        scale = ((rows + 0.1) / SIDE, (columns + 0.1) / SIDE)
        table = functional.interpolate(table, scale_factor=scale, mode="bicubic")
        places = table.permute(0, 2, 3, 1).flatten(1, 2)
        self.places.copy_(torch.cat([self.pos_embed[:, :1], places], 1))

    def forward(self, image):
        x = self.patch_embed.proj(image).flatten(2).transpose(1, 2)
        x = torch.cat([self.cls_token, x], 1) + self.places
        found = []
        for i, block in enumerate(self.blocks):
            x = block(x)
            if i in TAPS:
                found.append(self.norm(x)[0, 1:])
        return torch.stack(found)
