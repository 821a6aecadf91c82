"""Messages without wheels that are built here, and the substitute for our own message."""

import json
import subprocess
import sys

import pytest
from std_msgs.msg import Header

from expmap_ros import messages
from ros.build_messages import missing_tools


@pytest.mark.skipif(bool(missing_tools()), reason=f"not built without {missing_tools()}")
def test_the_message_of_2013_is_built_with_the_wheels():
    from expmap_msgs.msg import PosesInMap

    made = messages.poses_in_map([7, 3], [0.75, 0.25], header=Header(frame_id="map"))
    assert isinstance(made, PosesInMap) and messages.POSES_IN_MAP is PosesInMap
    assert (made.header.frame_id, list(made.poses), list(made.probabilities)) == ("map", [7, 3], [0.75, 0.25])


def test_without_it_the_same_is_a_text():
    code = (
        "import sys; sys.modules.update(dict.fromkeys(['expmap_msgs.msg', 'tf2_msgs.msg']))\n"
        "from expmap_ros import messages\n"
        "print(messages.TF_MESSAGE, messages.poses_in_map([7], [0.9], header=None).data)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    transforms, _, said = done.stdout.partition(" ")
    assert transforms == "None" and json.loads(said) == {"poses": [7], "probabilities": [0.9]}
