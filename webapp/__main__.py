"""`python -m webapp` runs the command `expmap`."""

from __future__ import annotations

from webapp.app.main import main

if __name__ == "__main__":
    main()
