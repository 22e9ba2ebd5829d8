"""What tells the scene filter a length."""
