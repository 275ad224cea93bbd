"""The renderer: skin in texture space, one texel one surface point, differentiable."""
