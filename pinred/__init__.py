"""pinred: reduction of multibody systems with symmetry, backed by Pinocchio.

    system = pinred.load("falling_cat")
    red = pinred.Reduction(system)
    traj = pinred.simulate(system, duration=10.0)
    print(pinred.compare(traj))

Names are imported when they are first used, so that `import pinred` is light; the stub beside
this file says where each stands.
"""

import lazy_loader

from .common.version import __version__ as __version__

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
