"""Pictures: shaded surfaces as PNG, sections as SVG."""
