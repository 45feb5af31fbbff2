"""What is left when the model is subtracted: noise models, one file each, found here.

A file of this folder adds what it holds by two names: ``MODELS``, the models that a
configuration may ask for, and ``SCALES``, every number that their noise is described by.
"""

from importlib import import_module
from pkgutil import iter_modules

from bayesfric.inference.noise.residual_noise import NoiseModel
from bayesfric.inference.noise.scale import Scale

_modules = [import_module(f"{__name__}.{found.name}") for found in iter_modules(__path__)]

NOISE_MODELS: dict[str, NoiseModel] = {
    model.name: model for module in _modules for model in getattr(module, "MODELS", ())
}
SCALES: dict[str, Scale] = {
    scale.name: scale for module in _modules for scale in getattr(module, "SCALES", ())
}
