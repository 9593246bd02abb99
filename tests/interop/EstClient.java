import java.io.FileInputStream;
import java.net.Socket;
import java.security.KeyPair;
import java.security.KeyPairGenerator;
import java.security.KeyStore;
import java.security.Security;
import java.security.cert.CertificateFactory;
import java.security.cert.TrustAnchor;
import java.security.cert.X509Certificate;
import java.security.spec.ECGenParameterSpec;
import java.util.Base64;
import java.util.Set;
import javax.net.ssl.KeyManagerFactory;
import javax.security.auth.x500.X500Principal;
import org.bouncycastle.cert.X509CertificateHolder;
import org.bouncycastle.est.CSRRequestResponse;
import org.bouncycastle.est.ESTAuth;
import org.bouncycastle.est.ESTService;
import org.bouncycastle.est.EnrollmentResponse;
import org.bouncycastle.est.jcajce.ChannelBindingProvider;
import org.bouncycastle.est.jcajce.JcaHttpAuthBuilder;
import org.bouncycastle.est.jcajce.JcaJceUtils;
import org.bouncycastle.est.jcajce.JsseESTServiceBuilder;
import org.bouncycastle.jce.provider.BouncyCastleProvider;
import org.bouncycastle.jsse.BCSSLConnection;
import org.bouncycastle.jsse.provider.BouncyCastleJsseProvider;
import org.bouncycastle.jsse.BCSSLSocket;
import org.bouncycastle.operator.ContentSigner;
import org.bouncycastle.operator.jcajce.JcaContentSignerBuilder;
import org.bouncycastle.pkcs.PKCS10CertificationRequestBuilder;
import org.bouncycastle.pkcs.jcajce.JcaPKCS10CertificationRequestBuilder;
import org.bouncycastle.util.Store;

/** EstClient HOST:PORT TLS-CA ID SECRET NAME: gets CAs and attributes, enrols, and renews. */
public class EstClient {
    static final String LINK = "tls-unique";

    public static void main(String[] given) throws Exception {
        Security.addProvider(new BouncyCastleProvider());
        Security.addProvider(new BouncyCastleJsseProvider());
        ESTService service = service(given, null);
        print("CA", service.getCACerts().getCertificateStore());
        CSRRequestResponse attributes = service.getCSRAttributes();
        attributes.getAttributesResponse().getRequirements().forEach(
            each -> System.out.println("ATTRIBUTE " + each));
        ESTAuth user = new JcaHttpAuthBuilder(null, given[2], given[3].toCharArray())
            .setProvider("BC").build();
        KeyPair first = keys();
        EnrollmentResponse got =
            service.simpleEnrollPoP(false, asking(first, given[4]), signer(first), user);
        print("ENROLLED", got.getStore());
        ESTService own = service(given, manager(first, got.getStore()));
        KeyPair second = keys();
        got = own.simpleEnrollPoP(true, asking(second, given[4]), signer(second), null);
        print("RENEWED", got.getStore());
    }

    static ESTService service(String[] given, KeyManagerFactory own) throws Exception {
        X509Certificate ca;
        try (FileInputStream file = new FileInputStream(given[1])) {
            ca = (X509Certificate) CertificateFactory.getInstance("X.509").generateCertificate(file);
        }
        JsseESTServiceBuilder builder = new JsseESTServiceBuilder(given[0],
            JcaJceUtils.getCertPathTrustManager(Set.of(new TrustAnchor(ca, null)), null));
        builder.withProvider("BCJSSE").withTLSVersion("TLSv1.2");
        builder.withChannelBindingProvider(new Link());
        if (own != null) {
            builder.withKeyManagers(own.getKeyManagers());
        }
        return builder.build();
    }

    /** The link of RFC 7030 3.5. */
    static class Link implements ChannelBindingProvider {
        public boolean canAccessChannelBinding(Socket socket) {
            return socket instanceof BCSSLSocket;
        }

        public byte[] getChannelBinding(Socket socket, String kind) {
            System.out.println("LINKED " + kind);
            return ((BCSSLSocket) socket).getConnection().getChannelBinding(kind);
        }
    }

    static KeyPair keys() throws Exception {
        KeyPairGenerator maker = KeyPairGenerator.getInstance("EC", "BC");
        maker.initialize(new ECGenParameterSpec("secp256r1"));
        return maker.generateKeyPair();
    }

    static PKCS10CertificationRequestBuilder asking(KeyPair keys, String name) {
        return new JcaPKCS10CertificationRequestBuilder(
            new X500Principal("CN=" + name), keys.getPublic());
    }

    static ContentSigner signer(KeyPair keys) throws Exception {
        return new JcaContentSignerBuilder("SHA256withECDSA").setProvider("BC")
            .build(keys.getPrivate());
    }

    static KeyManagerFactory manager(KeyPair keys, Store<X509CertificateHolder> found)
        throws Exception {
        byte[] der = ESTService.storeToArray(found)[0].getEncoded();
        KeyStore store = KeyStore.getInstance("PKCS12", "BC");
        store.load(null, null);
        store.setKeyEntry("own", keys.getPrivate(), null, new X509Certificate[] {
            (X509Certificate) CertificateFactory.getInstance("X.509")
                .generateCertificate(new java.io.ByteArrayInputStream(der))});
        KeyManagerFactory made = KeyManagerFactory.getInstance("PKIX", "BCJSSE");
        made.init(store, null);
        return made;
    }

    static void print(String what, Store<X509CertificateHolder> found) throws Exception {
        for (X509CertificateHolder each : ESTService.storeToArray(found)) {
            System.out.println(
                what + " " + Base64.getEncoder().encodeToString(each.getEncoded()));
        }
    }
}
