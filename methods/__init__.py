"""The methods that come with the suite, as lazy ``"module:Class"`` strings: naming them imports none of them."""

from __future__ import annotations

BUILTIN: dict[str, str] = {
    "identity": "methods.identity:Identity",
    "nearest": "methods.nearest:Nearest",
    "child-reference": "methods.child_reference:ChildReference",
    "dynamic-scaling": "methods.dynamic_scaling:DynamicScaling",
    "hsu": "methods.hsu.method:Hsu",
    "holden": "methods.holden.method:Holden",
    "cyclegan": "methods.cyclegan.method:CycleGan",
    "cyclegan-kc": "methods.cyclegan_kc.method:CycleGanKc",
}
