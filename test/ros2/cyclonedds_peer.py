"""A DDS participant of another vendor, which prints the texts that it receives; started by a test.

It publishes each of its arguments on the topic ``texts`` and reads the topic ``echo``, until it has received as many.
"""

import os
import sys
import time
from dataclasses import dataclass
from typing import List

os.environ["CYCLONEDDS_URI"] = """\
<CycloneDDS><Domain Id="any">
  <General>
    <Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces><AllowMulticast>false</AllowMulticast>
  </General>
  <Discovery>
    <ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>30</MaxAutoParticipantIndex>
    <Peers><Peer address="127.0.0.1"/></Peers>
  </Discovery>
</Domain></CycloneDDS>"""

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

TIMEOUT_SECONDS = 60.0


@dataclass
class Text(IdlStruct, typename="std_msgs::msg::dds_::String_"):  # type: ignore[call-arg, misc, unused-ignore]
    """A ``std_msgs/msg/String``."""

    data: str


def main(texts: List[str]) -> None:
    """Exchange the texts."""
    quality = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(100))
    participant = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
    writer = DataWriter(participant, Topic(participant, "rt/texts", Text, qos=quality), qos=quality)
    reader = DataReader(participant, Topic(participant, "rt/echo", Text, qos=quality), qos=quality)
    end = time.monotonic() + TIMEOUT_SECONDS
    while not (writer.get_matched_subscriptions() and reader.get_matched_publications()):
        if time.monotonic() > end:
            sys.exit("the node has not been found")
        time.sleep(0.02)
    for text in texts:
        writer.write(Text(text))
    received: List[str] = []
    while len(received) < len(texts) and time.monotonic() < end:
        received += [sample.data for sample in reader.take(100)]
        time.sleep(0.02)
    print("\n".join(received))


if __name__ == "__main__":
    main(sys.argv[1:])
