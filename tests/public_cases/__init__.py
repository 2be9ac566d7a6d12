"""Cases from public reports, with the right value of each: see README.md."""
