import ast

from zsdist import source


def test_words_and_layout_change_no_hash_and_statements_do():
    plain = ast.parse("def f(x):\n    return x + 1")
    worded = ast.parse('"""Of a module."""\ndef f(x):  # adds\n    """Adds."""\n\n    return (x + 1)')
    assert source._statements(plain) == source._statements(worded)
    assert source._statements(plain) != source._statements(ast.parse("def f(x):\n    return x + 2"))


def test_a_hash_is_of_the_modules_below_its_roots():
    camera, vision = source.modules("zsdist.sim.env"), source.modules("zsdist.vision.visual_act")
    assert "zsdist.sim.camera.shading" in camera and "zsdist.vision.encoders.lite0" in vision
    assert "zsdist.sim.camera.shading" not in vision and "zsdist.config" not in camera | vision
    assert source.modules("zsdist.sim.env", "zsdist.vision.visual_act") == camera | vision
    assert len({source.sha256("zsdist.sim.env"), source.sha256("zsdist.vision.visual_act")}) == 2
