"""Reading and writing files so that every fault is one line and a write is whole or not at all."""
