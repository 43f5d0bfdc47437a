"""Export of policies as bundles and ONNX files, and policies that act from them."""
