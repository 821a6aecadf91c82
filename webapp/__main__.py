"""`python -m webapp` is `expmap`."""

from __future__ import annotations

from webapp.app.main import main

if __name__ == "__main__":
    main()
