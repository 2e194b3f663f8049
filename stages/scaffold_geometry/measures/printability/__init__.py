"""What a printer would trip over in a finished solid: one module a rule, each with a verdict, numbers and places.

`verdict.lint` asks them all; `rules.PrintRules` says what the printer can do.
"""
