"""Figures of a report, as SVG panels that follow the page's colours and width."""
