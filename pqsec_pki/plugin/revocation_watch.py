"""Watches revocation lists, and finds participants and peers that were revoked while running."""

from collections.abc import Callable, Iterator
from dataclasses import replace

from pqsec_pki.errors import PqsecError, VerificationError
from pqsec_pki.plugin import lists
from pqsec_pki.plugin.handles import Handles
from pqsec_pki.plugin.identity import Local
from pqsec_pki.plugin.lists import NewestLists
from pqsec_pki.plugin.notes import Clock
from pqsec_pki.plugin.participant import Participant
from pqsec_pki.plugin.peer_table import PeerTable


class RevocationWatch:
    """Applies the revocation lists of a connection's participants to them and their peers."""

    def __init__(
        self,
        handles: Handles,
        peers: PeerTable,
        newest: NewestLists,
        clock: Clock,
        note: Callable[[str], None],
    ) -> None:
        self._handles, self._peers = handles, peers
        self._lists, self._now, self._note = newest, clock, note
        self._told: set[int] = set()

    def admitted(self, participant: Participant) -> Participant:
        """A new participant, with the newest lists of its CAs that the agent knows.

        VerificationError if a list revokes it, or is not valid.
        """
        return replace(participant, sets=tuple(map(self._admitted, participant.sets)))

    def _admitted(self, local: Local) -> Local:
        newest = self._with_newest(local)
        if newest is not local:
            problems = tuple(newest.anchors.identity_problems(newest.certificate, self._now()))
            if problems:
                raise VerificationError(*problems)
        return newest

    def next(self) -> int:
        """The handle of a revoked identity that was not reported yet; 0 if there is none.

        PqsecError for a refused list, after all handles were reported.
        """
        refusal = self._read_again()
        self._told.intersection_update(handle for handle, _ in self._handles.all(object))
        for handle in self._revoked():
            if handle not in self._told:
                self._told.add(handle)
                return handle
        if refusal:
            raise refusal
        return 0

    def _read_again(self) -> PqsecError | None:
        """Read the lists whose files have changed, for later handshakes; returns the last error."""
        refusal = None
        for handle, participant in self._handles.all(Participant):
            sets = list(participant.sets)
            for number, local in enumerate(sets):
                try:
                    sets[number], refused = self._renewed(local)
                except PqsecError as error:
                    refused = error
                refusal = refused or refusal
            self._handles.replace(handle, replace(participant, sets=tuple(sets)))
        return refusal

    def _renewed(self, local: Local) -> tuple[Local, PqsecError | None]:
        """`local` with the list that applies now, and why that is not its own file's, if so."""
        fresh = local.with_newer_list()
        newest = self._with_newest(fresh)
        if fresh is not local and newest is not fresh and fresh.revoked and newest.revoked:
            refusal = lists.refusal(fresh.revoked, newest.revoked)
            return replace(newest, list_state=local.list_state), refusal  # to report it again
        return newest, None

    def _with_newest(self, local: Local) -> Local:
        """`local`, or the same with a newer list that another participant of its CA has."""
        if local.revoked is None:
            return local
        ca, strict = local.anchors.identity_ca, local.anchors.signed_twice
        newest = self._lists.newest(ca, local.revoked, alternative=strict, now=self._now())
        if newest is local.revoked:
            return local
        self._note(
            f"list {newest.number} of {ca.subject_name}, which another"
            f" participant has, applies in place of list {local.revoked.number}"
        )
        return local.with_list(newest)

    def _revoked(self) -> Iterator[int]:
        participants = dict(self._handles.all(Participant))
        for handle, participant in participants.items():
            if participant.is_revoked:
                yield handle
        for identity, peer, certificate in self._peers.authenticated():
            if participants[identity].revokes(certificate):
                yield peer
