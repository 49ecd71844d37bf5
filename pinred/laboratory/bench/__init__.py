"""Benchmarks, run by `pinred bench …` or from Python.

    from pinred.laboratory.bench import bench_accuracy
    for result in bench_accuracy():
        print(result)

Names are imported on first use; the stub `__init__.pyi` lists their modules.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
