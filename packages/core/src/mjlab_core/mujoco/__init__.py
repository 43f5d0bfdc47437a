"""MuJoCo's fields, contacts and drawings, as members share them."""
