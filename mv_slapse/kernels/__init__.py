"""Compiled kernels: pure functions of arrays in C++17, and the module that binds them."""
