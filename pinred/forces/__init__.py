"""Everything that acts on a system: forces, controllers, and the signals they follow.

One set of expressions serves every route.  Imports `reduction` and what lies below it.
Names are imported when they are first used; the stub beside this file says where each stands.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
