"""The stages of `zsdist.pretrain`: pictures, training, check and figures."""
