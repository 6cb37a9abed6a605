# SPDX-License-Identifier: MIT
"""A playground in the browser: a generated robot's own C as WebAssembly, in one static page (``stiffgen play``)."""
