"""Files and what is written: atomic writes, guarded reads, arrays, figures and tables."""
