"""LLVM code of the function by which numba computes the strides of a reshaped array."""

from __future__ import annotations

RESHAPE = "numba_attempt_nocopy_reshape"
# It accepts arrays in C order alone, and returns 0 for others, as numba's does where it needs a
# copy. The arrays have entries, and both shapes have equally many; the last argument is not used.
RESHAPE_CODE = f"""
define i32 @{RESHAPE}(i64 %axes, ptr %dims, ptr %strides, i64 %new_axes, ptr %new_dims,
                      ptr %new_strides, i64 %itemsize, i32 %columns) {{
entry:
  br label %old
old:
  %k = phi i64 [ %axes, %entry ], [ %axis, %checked ]
  %expected = phi i64 [ %itemsize, %entry ], [ %larger, %checked ]
  %more = icmp sgt i64 %k, 0
  br i1 %more, label %check, label %new
check:
  %axis = sub i64 %k, 1
  %dim.at = getelementptr i64, ptr %dims, i64 %axis
  %dim = load i64, ptr %dim.at
  %stride.at = getelementptr i64, ptr %strides, i64 %axis
  %stride = load i64, ptr %stride.at
  %equal = icmp eq i64 %stride, %expected
  %single = icmp eq i64 %dim, 1
  %fits = or i1 %equal, %single
  %larger = mul i64 %expected, %dim
  br i1 %fits, label %checked, label %copy
checked:
  br label %old
new:
  %j = phi i64 [ %new_axes, %old ], [ %new_axis, %fill ]
  %size = phi i64 [ %itemsize, %old ], [ %new_size, %fill ]
  %unfilled = icmp sgt i64 %j, 0
  br i1 %unfilled, label %fill, label %done
fill:
  %new_axis = sub i64 %j, 1
  %new_stride.at = getelementptr i64, ptr %new_strides, i64 %new_axis
  store i64 %size, ptr %new_stride.at
  %new_dim.at = getelementptr i64, ptr %new_dims, i64 %new_axis
  %new_dim = load i64, ptr %new_dim.at
  %new_size = mul i64 %size, %new_dim
  br label %new
done:
  ret i32 1
copy:
  ret i32 0
}}
"""
