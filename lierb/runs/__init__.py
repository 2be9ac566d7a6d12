"""One run of a batch: memory, chunks, threads, progress, tables."""
