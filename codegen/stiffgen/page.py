# SPDX-License-Identifier: MIT
"""How a page of stiffgen looks in a browser: colours on light and dark pages, type and tables. Reports share it."""

from __future__ import annotations

PAGE, DARK_PAGE = ("#ffffff", "#1f2328"), ("#0d1117", "#e6edf3")
"""Background and text on light and on dark pages."""
STYLE = f"""\
:root {{
  color-scheme: light dark;
  --page: {PAGE[0]}; --text: {PAGE[1]}; --line: #8886; --warn: #cc2936; --link: #0969da;
}}
@media (prefers-color-scheme: dark) {{
  :root {{ --page: {DARK_PAGE[0]}; --text: {DARK_PAGE[1]}; --link: #58a6ff; }}
}}
body {{
  background: var(--page); color: var(--text);
  font: 15px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem;
}}
a {{ color: var(--link); }}
table {{ border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: 13px; }}
.wide {{ overflow-x: auto; }}
.warning {{ border-left: 4px solid var(--warn); padding: 0.2rem 0.8rem; overflow-wrap: anywhere; }}
img {{ max-width: 100%; }}
figure {{ margin: 1.5rem 0; }}
"""
"""The style sheet's part that all pages have; none of it is text that a template has to escape."""
