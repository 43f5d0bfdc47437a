# MuJoCo's bindings ship no type information that a checker can read.
from typing import Any

def __getattr__(name: str) -> Any: ...
