"""Configs: what TOML files may say, read and checked before anything is computed."""
