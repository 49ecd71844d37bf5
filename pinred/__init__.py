"""pinred: reduction of multibody systems with symmetry, backed by Pinocchio.

    system = pinred.load("falling_cat")
    red = pinred.Reduction(system)
    traj = pinred.simulate(system, duration=10.0)
    print(pinred.compare(traj))

Each name is imported at its first use, so that `import pinred` is fast.  The stub file
`__init__.pyi` maps each name to its module.
"""

import lazy_loader

from .common.errors import __version__ as __version__

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
