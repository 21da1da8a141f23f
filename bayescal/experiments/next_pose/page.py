"""The page: what to measure next or to stop, and the course."""

from bayescal.report.blocks import Page


def build_page(results):
    s=results.summary
    return Page(kind="Next pose",name=s["name"],title=s["title"],origin=s["data_origin"],headline=s["decision"],verdict=(),sections=())
