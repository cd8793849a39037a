"""The C++ tests, `native/tests`, under the sanitizers of addresses and of undefined behaviour."""

import sanitized


def test_the_cpp_tests_pass_under_the_sanitizers() -> None:
    parts = ("batch", "engine", "kinematics", "levels", "qp", "singular_values")
    folder = sanitized.build(*(f"test_{part}" for part in parts))
    sanitized.done([sanitized.tool("ctest"), "--test-dir", folder, "--output-on-failure"])
