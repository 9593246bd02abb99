"""What stacks do otherwise than the standard or each other, and which rule tells of it.

`fields` names the fields of a `Interpretation` in which the stack's row of pqsec_pki.access differs
from the standard's: a test holds that none is forgotten.
"""

from dataclasses import dataclass

CYCLONE, FAST, OPENDDS = "cyclonedds", "fastdds", "opendds"
CONFIGURATION = "stands in the stack's configuration, which is not looked at"


@dataclass(frozen=True, slots=True)
class Habit:
    """A stack, what it does, and the ids of rules between spaces, or why there is none."""

    stack: str
    what: str
    told_by: str
    fields: tuple[str, ...] = ()

    @property
    def rules(self) -> list[str]:
        """The rules that tell of it."""
        return self.told_by.split() if self.told_by.startswith("PQS") else []


_USE = ("use own", "use peer")

HABITS = (
    Habit("all", "the first rule that matches decides", "PQS254 PQS255 PQS227 PQS228"),
    Habit("all", "a deny_rule for partitions denies the topic in all of them", "PQS256"),
    Habit("all", "an allow_rule without partitions is for endpoints in none", "PQS258"),
    Habit("all", "partitions of endpoints are compared as names", "PQS256 PQS275"),
    Habit("all", "braces are no alternatives", "PQS235"),
    Habit("all", "payloads have no origin authentication", "PQS214"),
    Habit("all", "key usage of a participant's certificate is not looked at", "PQS129"),
    Habit(CYCLONE, "crashes on an empty topic, expression or rule without domains",
          "PQS217 PQS218", ("flaw",)),
    Habit(CYCLONE, "refuses domains above 230, and governance with an empty range",
          "PQS233 PQS234", ("flaw",)),
    Habit(CYCLONE, "refuses elements and attributes it does not know", "PQS206 PQS209 PQS210"),
    Habit(CYCLONE, "takes a misspelt default for DENY", "PQS213"),
    Habit(CYCLONE, "takes a missing default for DENY", "is safe; for Fast DDS PQS216 tells of it"),
    Habit(CYCLONE, "takes a not_before it cannot read", "PQS264"),
    Habit(CYCLONE, "counts a time after 2261 as long past, of not_before too", "PQS263",
          ("in_force",)),
    Habit(CYCLONE, "counts a time before 1970 as long past",
          "makes no difference: it is, for every stack", ("in_force",)),
    Habit(CYCLONE, "a grant is not in force in the second it begins or ends",
          "makes no difference but in that second", ("in_force",)),
    Habit(CYCLONE, "a range without an end is its first domain", "PQS231", ("includes",)),
    Habit(CYCLONE, "a range without a start is none", "PQS232"),
    Habit(CYCLONE, "a subject needs only be part of the grant's, in any order", "PQS401",
          ("is_for",)),
    Habit(CYCLONE, "of two parts of one kind in a name the first counts", "PQS419 PQS431",
          ("is_for",)),
    Habit(CYCLONE, "a name with an empty piece, or more than 20, matches nothing", "PQS424",
          ("is_for",)),
    Habit(CYCLONE, "0.10 refuses spaces in a subject_name", "PQS413"),
    Habit(CYCLONE, "brackets have ] in them, no classes, and ^ is no negation",
          "PQS236 PQS239 PQS241", ("covers", "governs")),
    Habit(CYCLONE, "a backslash is a character", "PQS238", ("covers", "governs")),
    Habit(CYCLONE, "time grows with a power of the length of a name, one more for each star",
          "PQS237"),
    Habit(CYCLONE, "asks for the topic first, with rules for any action and partition",
          "PQS256 PQS270", _USE),
    Habit(CYCLONE, "its builtin topics are open to all members", "PQS269", _USE),
    Habit(CYCLONE, "a deny_rule without partitions is for endpoints in none", "PQS272",
          ("partitions_met",)),
    Habit(CYCLONE, "data tags and relay rules are not asked", "PQS259 PQS260",
          ("tags_met", "knows_relay")),
    Habit(CYCLONE, "the first grant for a subject counts, though it has run out", "PQS261"),
    Habit(CYCLONE, "of a file of CAs the first counts, and it must be self-signed",
          "PQS131 PQS132"),
    Habit(CYCLONE, "0.10 wants digitalSignature of the permissions CA, and that it is in force;"
          " master does not", "PQS110 PQS124"),
    Habit(CYCLONE, "expands ${VAR}, trims values, refuses CRL with TrustedCADirectory, and warns"
          " of <DDSSecurity>", CONFIGURATION),
    Habit(FAST, "reads times as local ones", "PQS266 PQS323 PQS324", ("in_force",)),
    Habit(FAST, "reads the clock in whole seconds", "makes no difference beyond a second",
          ("in_force",)),
    Habit(FAST, "wants elements in the order of the schema", "PQS208"),
    Habit(FAST, "refuses a comment before </dds>", "PQS207"),
    Habit(FAST, "compares values and names with the spaces around them", "PQS212 PQS412"),
    Habit(FAST, "2.9 wants the parts of a subject in the order of RFC 2253", "PQS415",
          ("is_for",)),
    Habit(FAST, "a range without an end is its first domain", "PQS231", ("includes",)),
    Habit(FAST, "a range that ends at 0 is its first domain",
          "makes no difference: no other domain lies in it, or PQS234 tells", ("includes",)),
    Habit(FAST, "a backslash is a character", "PQS238", ("covers", "governs")),
    Habit(FAST, "a topic_expression is compared in both directions, the topic as the pattern too",
          "matters only for a topic whose own name is a pattern, and ROS 2 and IDL have none",
          ("governs",)),
    Habit(FAST, "a later grant counts where the first is not in force", "PQS261",
          ("skips_grants_out_of_force",)),
    Habit(FAST, "topics of one criterion are allowed in the partitions of another", "PQS257",
          ("partitions_met", *_USE)),
    Habit(FAST, "a deny_rule is for all partitions", "PQS256", ("partitions_met", *_USE)),
    Habit(FAST, "data tags are not asked", "PQS260", ("tags_met",)),
    Habit(FAST, "an empty topic_expression crashes 2.9 and 3.1", "PQS218", ("flaw",)),
    Habit(FAST, "the default lets nobody join: there must be an allow_rule",
          "PQS252 PQS274",
          ("join own", "join peer")),
    Habit(FAST, "a participant's own stack lets it join with an allow_rule for any domain",
          "its peers look at the domain, and refuse it", ("join own",)),
    Habit(FAST, "lets join on a domain that governance does not name",
          "no endpoint can be made there; where no domain is left, PQS309 tells",
          ("join own", "join peer")),
    Habit(FAST, "rules for all domains count for a participant's own endpoints", "PQS271",
          ("use own",)),
    Habit(FAST, "the default is not asked for topics", "PQS251", _USE),
    Habit(FAST, "a relay rule of a peer is a right to subscribe", "PQS259", ("use peer",)),
    Habit(FAST, "certificates must be signed with SHA-256", "PQS104"),
    Habit(FAST, "crashes on a certificate without subject", "PQS107"),
    Habit(FAST, "honours revocation lists in the file of the CA", "PQS144"),
    Habit(FAST, "2.9 does not log why it refuses a document",
          "`pqsec check` and `pqsec verify` say it"),
    Habit(FAST, "3 checks chains strictly: key identifiers, keyCertSign", "PQS123 PQS133"),
    Habit(FAST, "3 refuses unauthenticated participants with protected messages", "PQS222"),
    Habit(FAST, "3.6 crashes on a certificate that ends in 2500", "PQS113"),
    Habit(FAST, "takes file:// only, and 3 expands ${VAR}", CONFIGURATION),
    Habit(OPENDDS, "creates no participant if joining and all topics are controlled", "PQS230",
          ("join own",)),
    Habit(OPENDDS, "looks at a grant's times for endpoints only, of topics that are not open",
          "PQS320 PQS322", ("join own", "join peer", *_USE)),
    Habit(OPENDDS, "any governance rule for the domain may open it", "PQS228", ("join peer",)),
    Habit(OPENDDS, "any topic rule that matches may open the topic", "PQS240", _USE),
    Habit(OPENDDS, "a topic is not created where both actions are denied, in any partition",
          "PQS256", _USE),
    Habit(OPENDDS, "brackets and stars as ACE::wild_match has them", "PQS236 PQS239 PQS242",
          ("covers", "governs")),
    Habit(OPENDDS, "reads beyond a pattern with an open bracket", "PQS243", ("flaw",)),
    Habit(OPENDDS, "wants the parts of a subject in the order of the certificate",
          "PQS416 PQS421", ("is_for",)),
    Habit(OPENDDS, "wants octets for letters of a subject beyond ASCII", "PQS418", ("is_for",)),
    Habit(OPENDDS, "an endpoint without partitions meets all that allow_rules name", "PQS273",
          ("partitions_met",)),
    Habit(OPENDDS, "data tags and relay rules are not asked", "PQS259 PQS260",
          ("tags_met", "knows_relay")),
    Habit(OPENDDS, "forgets the second grant for a subject", "PQS261"),
    Habit(OPENDDS, "reads an attribute that a grant may lack", "PQS215"),
    Habit(OPENDDS, "takes elements in any order, unknown ones, and kinds in any case",
          "other stacks do not, and they are what counts"),
    Habit(OPENDDS, "of a file of CAs the first counts; no revocation lists", "PQS131 PQS147"),
    Habit(OPENDDS, "pins the signer of documents, and takes one signature", "PQS335 PQS340"),
)  # fmt: skip
