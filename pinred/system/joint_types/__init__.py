"""Joint types with one or several degrees of freedom: one module for each type.

A joint with several degrees of freedom is a product of hinges, slides and balls if its motion can
be carried out one after the other.  `split_joints` replaces such joints when a model is loaded.
This is exact: the massless bodies between the parts add no inertia.  A new type is one module in
this folder with a `JointType`, which is registered automatically.

Pinocchio's derivatives of the mass matrix are wrong for joints whose axes vary with q within the
joint (Universal, SphericalZYX, and composites).  These joints never reach them.
"""
