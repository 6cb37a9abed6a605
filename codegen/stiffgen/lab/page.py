# SPDX-License-Identifier: MIT
"""Appearance and security policy of HTML pages: colours on light and dark pages, type, tables. Reports share them."""

from __future__ import annotations

PAGE, DARK_PAGE = ("#ffffff", "#1f2328"), ("#0d1117", "#e6edf3")
"""Background and text on light and on dark pages."""
POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src 'self' file: data:"
"""Content security policy of reports: no script, nothing from the network, pictures beside the page."""
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
"""Part of the style sheet that all pages share; templates insert it without escaping."""
