// Go's own implementation of transparency logs and signed notes (golang.org/x/mod/sumdb) as a
// filter: a question in JSON comes in, what it answers goes out.
package main

import (
	"crypto/ecdsa"
	"crypto/sha256"
	"crypto/x509"
	"encoding/json"
	"fmt"
	"os"

	"golang.org/x/mod/sumdb/note"
	"golang.org/x/mod/sumdb/tlog"
)

// Proof is of a record: that leaf Old is in the tree of New leaves; or that this tree continues
// the one of Old leaves.
type Proof struct {
	Record   bool
	Old, New int64
	Hashes   [][]byte
}

// Question is what to compute, and what to check.
type Question struct {
	Leaves [][]byte
	Prove  []Proof
	Check  []Proof
	Roots  [][]byte
	Note   []byte
	Name   string
	Spki   []byte
}

// Answer has the roots of all sizes, proofs, whether each proof holds, and the text of the note.
type Answer struct {
	Roots  [][]byte
	Proofs []Proof
	Holds  []bool
	Text   string
	Error  string
}

type verifier struct {
	name string
	spki []byte
	key  *ecdsa.PublicKey
}

func (v verifier) Name() string { return v.name }

// KeyHash is that of signature type 0x02 of c2sp.org/signed-note.
func (v verifier) KeyHash() uint32 {
	h := sha256.Sum256(v.spki)
	return uint32(h[0])<<24 | uint32(h[1])<<16 | uint32(h[2])<<8 | uint32(h[3])
}

func (v verifier) Verify(msg, sig []byte) bool {
	h := sha256.Sum256(msg)
	return ecdsa.VerifyASN1(v.key, h[:], sig)
}

func main() {
	var q Question
	var a Answer
	must(json.NewDecoder(os.Stdin).Decode(&q))
	reader := stored(q.Leaves)
	for size := range append(q.Leaves, nil) {
		root, err := tlog.TreeHash(int64(size), reader)
		must(err)
		a.Roots = append(a.Roots, root[:])
	}
	for _, each := range q.Prove {
		a.Proofs = append(a.Proofs, prove(each, reader))
	}
	for _, each := range q.Check {
		a.Holds = append(a.Holds, holds(each, q))
	}
	if q.Note != nil {
		a.Text, a.Error = open(q)
	}
	must(json.NewEncoder(os.Stdout).Encode(a))
}

func stored(leaves [][]byte) tlog.HashReaderFunc {
	var hashes []tlog.Hash
	reader := func(indexes []int64) ([]tlog.Hash, error) {
		var found []tlog.Hash
		for _, index := range indexes {
			found = append(found, hashes[index])
		}
		return found, nil
	}
	for number, leaf := range leaves {
		more, err := tlog.StoredHashes(int64(number), leaf, tlog.HashReaderFunc(reader))
		must(err)
		hashes = append(hashes, more...)
	}
	return reader
}

func prove(p Proof, reader tlog.HashReaderFunc) Proof {
	var hashes []tlog.Hash
	var err error
	if p.Record {
		hashes, err = tlog.ProveRecord(p.New, p.Old, reader)
	} else {
		hashes, err = tlog.ProveTree(p.New, p.Old, reader)
	}
	must(err)
	for index := range hashes {
		p.Hashes = append(p.Hashes, hashes[index][:])
	}
	return p
}

func holds(p Proof, q Question) bool {
	var hashes []tlog.Hash
	for _, each := range p.Hashes {
		hashes = append(hashes, hash(each))
	}
	root := hash(q.Roots[p.New])
	if p.Record {
		return tlog.CheckRecord(hashes, p.New, root, p.Old, tlog.RecordHash(q.Leaves[p.Old])) == nil
	}
	return tlog.CheckTree(hashes, p.New, root, p.Old, hash(q.Roots[p.Old])) == nil
}

func open(q Question) (string, string) {
	key, err := x509.ParsePKIXPublicKey(q.Spki)
	must(err)
	known := verifier{q.Name, q.Spki, key.(*ecdsa.PublicKey)}
	opened, err := note.Open(q.Note, note.VerifierList(known))
	if err != nil {
		return "", err.Error()
	}
	return opened.Text, ""
}

func hash(data []byte) (found tlog.Hash) {
	copy(found[:], data)
	return found
}

func must(err error) {
	if err != nil {
		fmt.Fprintln(os.Stderr, err)
		os.Exit(1)
	}
}
