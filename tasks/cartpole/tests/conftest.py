import torch

# A second thread does not help with tiny tensors.
torch.set_num_threads(1)
