from torch import Tensor, cat, nn, relu, zeros


class OwnNet(nn.Module):
    """In this folder: `wcsim train-q --network own_network:OwnNet`. If `windowed = True`: image_shape (T, C, H, W)."""

    def __init__(self, image_shape: tuple[int, int, int], vector_size: int) -> None:  # (C, H, W); IMU + joystick
        super().__init__()
        self.cnn = nn.Sequential(nn.Conv2d(image_shape[0], 16, 8, 4), nn.ReLU(), nn.Conv2d(16, 16, 4, 2), nn.ReLU())
        size = self.cnn(zeros(1, *image_shape)).numel()
        self.dense = nn.Linear(size + vector_size, 64)

    def forward(self, image: Tensor, vector: Tensor) -> Tensor:
        """Image (B, C, H, W) in 0..1 and vector (B, vector_size) in -1..1, to (B, any number of features)."""
        return relu(self.dense(cat([self.cnn(image).flatten(1), vector], dim=1)))
