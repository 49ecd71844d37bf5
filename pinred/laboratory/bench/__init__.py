"""Measurements that anyone can repeat, by `pinred bench …` or from Python.

    from pinred.laboratory.bench import bench_accuracy
    for found in bench_accuracy():
        print(found)

Names are imported when they are first used; the stub beside this file says where each stands.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
