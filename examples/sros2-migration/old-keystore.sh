#!/bin/sh
# Makes what `ros2 security` of SROS2 0.13 would make for one enclave, with the same files, names
# and modes, in the folder `old`: for this example only, where ROS 2 is not at hand.
set -eu

ca() { openssl "$@" 2> /dev/null; }

mkdir -p old/public old/private old/enclaves/talker
cd old
printf 'basicConstraints = critical, CA:TRUE, pathlen:1\n' > ca.ext
ca ecparam -name prime256v1 -genkey -noout -out private/ca.key.pem
ca req -new -key private/ca.key.pem -subj /CN=sros2CA -out ca.csr
ca x509 -req -in ca.csr -signkey private/ca.key.pem -sha256 -days 3650 -extfile ca.ext \
    -out public/ca.cert.pem
for role in identity_ca permissions_ca; do
    ln -s ca.cert.pem "public/$role.cert.pem"
    ln -s ca.key.pem "private/$role.key.pem"
    ln -s "../../public/$role.cert.pem" "enclaves/talker/$role.cert.pem"
done

printf 'basicConstraints = critical, CA:FALSE\n' > leaf.ext
ca ecparam -name prime256v1 -genkey -noout -out enclaves/talker/key.pem
ca req -new -key enclaves/talker/key.pem -subj '/CN=\/talker' -out leaf.csr
ca x509 -req -in leaf.csr -CA public/ca.cert.pem -CAkey private/ca.key.pem -CAcreateserial \
    -sha256 -days 3650 -extfile leaf.ext -out enclaves/talker/cert.pem
chmod 644 private/ca.key.pem enclaves/talker/key.pem

pqsec permissions import ../nodes.policy.xml --validity 10y -o permissions.yaml > /dev/null 2>&1
pqsec permissions render permissions.yaml -o enclaves/talker/permissions.xml > /dev/null
printf 'domains: 0\n' > governance.yaml
pqsec governance render governance.yaml -o enclaves/governance.xml > /dev/null
for document in enclaves/governance enclaves/talker/permissions; do
    ca smime -sign -text -in "$document.xml" -out "$document.p7s" \
        -signer public/ca.cert.pem -inkey private/ca.key.pem
done
ln -s ../governance.p7s enclaves/talker/governance.p7s
rm -f ./*.csr ./*.ext ./*.yaml public/*.srl
