"""How stacks differ from the standard or from each other, and which rule reports it.

`fields` names the fields of an `Interpretation` in which the stack's row of pqsec_pki.access
differs from the standard's: a test checks that none is missing.
"""

from dataclasses import dataclass

CYCLONE, FAST, OPENDDS = "cyclonedds", "fastdds", "opendds"
CONFIGURATION = "it is in the stack's configuration, which `pqsec check` does not read"


@dataclass(frozen=True, slots=True)
class Habit:
    """A stack, what it does, and the ids of rules between spaces, or why there is none."""

    stack: str
    what: str
    told_by: str
    fields: tuple[str, ...] = ()

    @property
    def rules(self) -> list[str]:
        """The rules that report it."""
        return self.told_by.split() if self.told_by.startswith("PQS") else []


_USE = ("use own", "use peer")

HABITS = (
    Habit("all", "the first rule that matches decides", "PQS254 PQS255 PQS227 PQS228"),
    Habit("all", "a deny_rule for partitions denies the topic in all of them", "PQS256"),
    Habit("all", "an allow_rule without partitions applies to endpoints in none", "PQS258"),
    Habit("all", "partitions of endpoints are compared as names", "PQS256 PQS275"),
    Habit("all", "braces do not mean alternatives", "PQS235"),
    Habit("all", "payloads have no origin authentication", "PQS214"),
    Habit("all", "the key usage of a participant's certificate is ignored", "PQS129"),
    Habit(CYCLONE, "crashes on an empty topic, expression or rule without domains",
          "PQS217 PQS218"),
    Habit(CYCLONE, "refuses domains above 230, and governance with an empty range",
          "PQS233 PQS234", ("flaw",)),
    Habit(CYCLONE, "refuses unknown elements and attributes", "PQS206 PQS209 PQS210"),
    Habit(CYCLONE, "reads a misspelt default as DENY", "PQS213"),
    Habit(CYCLONE, "reads a missing default as DENY", "safe; for Fast DDS, PQS216 reports it"),
    Habit(CYCLONE, "accepts a not_before that it cannot read", "PQS264"),
    Habit(CYCLONE, "treats a time after 2261 as past, also in not_before", "PQS263",
          ("in_force",)),
    Habit(CYCLONE, "treats a time before 1970 as past",
          "no difference: it is past for every stack", ("in_force",)),
    Habit(CYCLONE, "a grant is not in force in the second it begins or ends",
          "a difference only in that second", ("in_force",)),
    Habit(CYCLONE, "a range without an end is its first domain", "PQS231", ("includes",)),
    Habit(CYCLONE, "a range without a start crashes it; governance with one is refused", "PQS232",
          ("flaw",)),
    Habit(CYCLONE, "the parts of a subject may be only some of the grant's, in any order", "PQS401",
          ("is_for",)),
    Habit(CYCLONE, "of two parts of one kind in a name, the first is used", "PQS419 PQS431",
          ("is_for",)),
    Habit(CYCLONE, "a name with an empty piece, or more than 20, matches nothing", "PQS424",
          ("is_for",)),
    Habit(CYCLONE, "0.10 refuses spaces in a subject_name", "PQS413"),
    Habit(CYCLONE, "brackets may contain ], have no classes, and ^ does not negate",
          "PQS236 PQS239 PQS241", ("covers", "governs")),
    Habit(CYCLONE, "a backslash is an ordinary character", "PQS238", ("covers", "governs")),
    Habit(CYCLONE, "its time is a power of a name's length; each star adds one to the exponent",
          "PQS237"),
    Habit(CYCLONE, "0.10 checks the topic first, with the rules for any action and partition",
          "PQS256 PQS270", _USE),
    Habit(CYCLONE, "11.0 denies a topic in every partition only if both actions are denied",
          "PQS256", _USE),
    Habit(CYCLONE, "its builtin topics are open to all members", "PQS269", _USE),
    Habit(CYCLONE, "a deny_rule without partitions applies to endpoints in none", "PQS272",
          ("partitions_met",)),
    Habit(CYCLONE, "data tags and relay rules are ignored", "PQS259 PQS260",
          ("tags_met", "knows_relay")),
    Habit(CYCLONE, "the first grant for a subject is used, even if it has expired", "PQS261"),
    Habit(CYCLONE, "only the first CA of a file is used, and it must be self-signed",
          "PQS131 PQS132"),
    Habit(CYCLONE, "0.10 requires digitalSignature of the permissions CA, and that it is valid now;"
          " master does not", "PQS110 PQS124"),
    Habit(CYCLONE, "expands ${VAR}, trims values, refuses CRL with TrustedCADirectory, and warns"
          " of <DDSSecurity>", CONFIGURATION),
    Habit(FAST, "reads times as local time", "PQS266 PQS323 PQS324", ("in_force",)),
    Habit(FAST, "reads the clock in whole seconds", "a difference of less than a second",
          ("in_force",)),
    Habit(FAST, "requires the elements in the order of the schema", "PQS208"),
    Habit(FAST, "refuses a comment before </dds>", "PQS207"),
    Habit(FAST, "compares values and names including the spaces around them", "PQS212 PQS412"),
    Habit(FAST, "2.9 requires the parts of a subject in the order of RFC 2253", "PQS415",
          ("is_for",)),
    Habit(FAST, "a range without an end is its first domain", "PQS231", ("includes",)),
    Habit(FAST, "a range that ends at 0 is its first domain",
          "no difference: it contains no other domain, or PQS234 reports it", ("includes",)),
    Habit(FAST, "a backslash is an ordinary character", "PQS238", ("covers", "governs")),
    Habit(FAST, "a topic_expression is compared in both directions, the topic as the pattern too",
          "it matters only for a topic whose own name is a pattern; ROS 2 and IDL have none",
          ("governs",)),
    Habit(FAST, "a later grant is used if the first is not in force", "PQS261",
          ("skips_grants_out_of_force",)),
    Habit(FAST, "topics of one criterion are also allowed in the partitions of another", "PQS257",
          ("partitions_met", *_USE)),
    Habit(FAST, "a deny_rule applies to all partitions", "PQS256", ("partitions_met", *_USE)),
    Habit(FAST, "data tags are ignored", "PQS260", ("tags_met",)),
    Habit(FAST, "an empty topic_expression crashes 2.9 and 3.1; an empty topic is refused",
          "PQS218", ("flaw",)),
    Habit(FAST, "the default never permits joining: it needs an allow_rule",
          "PQS252 PQS274",
          ("join own", "join peer")),
    Habit(FAST, "a participant's own stack lets it join with an allow_rule for any domain",
          "its peers check the domain, and refuse it", ("join own",)),
    Habit(FAST, "permits joining a domain that the governance does not name",
          "no endpoint can be created there; if no domain is left, PQS309 reports it",
          ("join own", "join peer")),
    Habit(FAST, "rules for all domains apply to a participant's own endpoints", "PQS271",
          ("use own",)),
    Habit(FAST, "the default is ignored for topics", "PQS251", _USE),
    Habit(FAST, "a relay rule of a peer is a right to subscribe", "PQS259", ("use peer",)),
    Habit(FAST, "certificates must be signed with SHA-256", "PQS104"),
    Habit(FAST, "crashes on a certificate without subject", "PQS107"),
    Habit(FAST, "uses revocation lists in the file of the CA", "PQS144"),
    Habit(FAST, "2.9 does not log why it refuses a document",
          "`pqsec check` and `pqsec verify` report the reason"),
    Habit(FAST, "3 checks chains strictly: key identifiers, keyCertSign", "PQS123 PQS133"),
    Habit(FAST, "3 refuses unauthenticated participants with protected messages", "PQS222"),
    Habit(FAST, "3.6 crashes on a certificate that ends in 2500", "PQS113"),
    Habit(FAST, "accepts only file://, and 3 expands ${VAR}", CONFIGURATION),
    Habit(OPENDDS, "creates no participant if joining and all topics are controlled", "PQS230",
          ("join own",)),
    Habit(OPENDDS, "checks a grant's times only for endpoints of topics that are not open",
          "PQS320 PQS322", ("join own", "join peer", *_USE)),
    Habit(OPENDDS, "any governance rule for the domain can open it", "PQS228", ("join peer",)),
    Habit(OPENDDS, "any topic rule that matches can open the topic", "PQS240", _USE),
    Habit(OPENDDS, "a topic is not created where both actions are denied, in any partition",
          "PQS256", _USE),
    Habit(OPENDDS, "interprets brackets and stars as ACE::wild_match does", "PQS236 PQS239 PQS242",
          ("covers", "governs")),
    Habit(OPENDDS, "reads beyond the end of a pattern with an open bracket", "PQS243", ("flaw",)),
    Habit(OPENDDS, "requires the parts of a subject in the order of the certificate",
          "PQS416 PQS421", ("is_for",)),
    Habit(OPENDDS, "requires octets for letters of a subject beyond ASCII", "PQS418", ("is_for",)),
    Habit(OPENDDS, "an endpoint without partitions matches all that allow_rules name", "PQS273",
          ("partitions_met",)),
    Habit(OPENDDS, "data tags and relay rules are ignored", "PQS259 PQS260",
          ("tags_met", "knows_relay")),
    Habit(OPENDDS, "ignores the second grant for a subject", "PQS261"),
    Habit(OPENDDS, "reads an attribute that a grant need not have", "PQS215"),
    Habit(OPENDDS, "accepts elements in any order, unknown elements, and kinds in any case",
          "other stacks do not, and their rules report it"),
    Habit(OPENDDS, "only the first CA of a file is used; no revocation lists", "PQS131 PQS147"),
    Habit(OPENDDS, "pins the signer of documents, and accepts one signature", "PQS335 PQS340"),
)  # fmt: skip
